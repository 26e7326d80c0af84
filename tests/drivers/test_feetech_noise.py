"""No wrong position passes noise: packets damaged at random, echo adapters, missing servos, gaps.

Wrong is a position further from the true one than a servo moves in one cycle, with the margin.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pytest

from tests.support.feetech_rig import FeetechRig
from twind_drivers.bus import BusSample
from twind_drivers.feetech.feetech_packet import instruction
from twind_drivers.half_duplex.checksum_reply import ChecksumReply
from twind_drivers.half_duplex.position_plausibility import AGREE, FASTEST, MARGIN, PositionPlausibility
from twind_drivers.virtual.faulty_byte_stream import SerialAdapter

PERIOD = 0.01
REACH = FASTEST * PERIOD + MARGIN
IDS = range(1, 251)
DATA = 6  # bytes
SPAN = 6 + DATA  # bytes of a packet
AHEAD = 4  # bytes of a burst before a packet
KINDS = 8
EMPTY = np.zeros(len(IDS), np.int64)


class Outcome(NamedTuple):
    """Packets of a campaign. `wrong`: positions that passed; `slight`: those within reach of the true one."""

    damaged: int
    passed: int
    slight: int
    wrong: int


def damaged(packets: np.ndarray, hit: np.ndarray, random: np.random.Generator) -> bytes:
    """Return the bytes (m, SPAN) of a reading, of which each packet of `hit` (m,) is damaged in one way."""
    count = len(packets)
    kind = np.where(hit, random.integers(0, KINDS, count), -1)
    wide = np.concatenate([random.integers(0, 256, (count, AHEAD), np.uint8), packets], axis=1)
    keep = np.ones(wide.shape, np.bool_)
    keep[:, :AHEAD] = (kind == 0)[:, None]  # a burst of noise before it
    at = AHEAD + random.integers(0, SPAN, count)
    other = AHEAD + random.integers(0, SPAN, count)
    every = np.arange(count)
    for flips, where in ((1, at), (2, at), (3, other)):  # one to three bits
        rows = every[(kind >= flips) & (kind <= 3)]
        wide[rows, where[rows]] ^= (1 << random.integers(0, 8, len(rows))).astype(np.uint8)
        other = AHEAD + random.integers(0, SPAN, count)
        at = np.where(flips == 1, other, at)
    for place, rows in ((at, every[(kind == 4) | (kind == 5)]), (other, every[kind == 5])):
        wide[rows, place[rows]] = random.integers(0, 256, len(rows), np.uint8)  # one or two bytes
    rows = every[kind == 6]  # two bytes lost to zero, every second time those of the position
    position = random.random(len(rows)) < 0.5
    wide[rows, np.where(position, AHEAD + 5, at[rows])] = 0
    wide[rows, np.where(position, AHEAD + 6, other[rows])] = 0
    rows = every[kind == 7]
    keep[rows, at[rows]] = False  # a byte lost
    return wide[keep].tobytes()


def motion() -> Iterator[np.ndarray]:
    """Yield true positions (m,) of each cycle: at rest at zeros' worst counts, and up to 3,400 counts/s."""
    worst = np.array([2041 - 255 * step for step in range(6)])  # low and high byte add up to 256
    base = np.resize(worst, len(IDS))
    phase = np.linspace(0.0, 6.0, len(IDS))
    speed = np.where(np.arange(len(IDS)) % 2, 3400.0, 0.0)
    cycle = 0
    while True:
        swing = speed / 6.0 * np.sin(6.0 * cycle * PERIOD + phase)
        yield (base + 1000 * (speed > 0.0) + np.rint(swing)).astype(np.int64)
        cycle += 1


def packets_of(position: np.ndarray) -> np.ndarray:
    """Return the sound packets (m, SPAN) of a reading."""
    found = np.zeros((len(IDS), SPAN), np.uint8)
    found[:] = np.frombuffer(instruction(0, 0, bytes(DATA)), np.uint8)
    found[:, 2] = IDS
    found[:, 5] = position & 0xFF
    found[:, 6] = position >> 8
    found[:, 9] = 200  # load
    found[:, -1] = ~found[:, 2:-1].sum(axis=1) & 0xFF
    return found


def campaign(cycles: int, share: float, seed: int) -> Outcome:
    """Read `cycles` times, `share` of the packets damaged; every 150 cycles nobody answers for 0.4 s."""
    random = np.random.default_rng(seed)
    reply = ChecksumReply(tuple(IDS), DATA)
    filter = PositionPlausibility(len(IDS), PERIOD)
    total = passed = slight = wrong = 0
    for cycle, true in zip(range(cycles), motion(), strict=False):
        silent = cycle % 150 >= 110
        hit = (random.random(len(IDS)) < share) & (cycle >= 10) & (not silent)
        data = b"" if silent else damaged(packets_of(true), hit, random)
        reply.start()
        reply.receive_buffer()[: len(data)] = data
        reply.take(len(data))
        reply.end()
        position = np.ascontiguousarray(reply.data[:, :2]).view("<u2")[:, 0].astype(np.int64)
        position = np.where(position & 0x8000, -(position & 0x7FFF), position)
        sample = filter.filter(_sample(cycle * PERIOD, position, reply.heard.copy()))
        off = np.abs(sample.position - true) * sample.heard
        total += int(hit.sum())
        passed += int((reply.heard & hit).sum())
        slight += int(((off > 0) & (off <= REACH)).sum())
        wrong += int((off > REACH).sum())
    return Outcome(total, passed, slight, wrong)


def _sample(now: float, position: np.ndarray, fresh: np.ndarray) -> BusSample:
    every = np.ones(len(IDS), np.bool_)
    error = EMPTY.astype(np.uint8)
    return BusSample(now, now, position, EMPTY, EMPTY, error, fresh, every, 0, 0, None, ())


@pytest.mark.parametrize("share", [1.0, 0.3])
def test_no_wrong_position_passes_damaged_packets(share: float) -> None:
    outcome = campaign(300, share, seed=1)
    assert outcome.passed > 100, "the damage must pass checksums"
    assert outcome.wrong == 0, outcome


@pytest.mark.campaign
@pytest.mark.parametrize("share", [1.0, 0.3])
def test_no_wrong_position_passes_a_million_damaged_packets(share: float) -> None:
    outcome = campaign(round(1.4e6 / len(IDS) / share), share, seed=2)
    print(share, outcome)
    assert outcome.damaged >= 1_000_000
    assert outcome.wrong == 0, outcome


@pytest.mark.parametrize("echo", [False, True])
@pytest.mark.parametrize("missing", [None, 2])
def test_no_wrong_position_passes_on_a_noisy_bus(echo: bool, missing: int | None) -> None:
    rig = FeetechRig(adapter=SerialAdapter(echo=echo))
    rig.perform(rig.reader.identify())
    rig.ticks(AGREE)
    if missing is not None:
        rig.faults.silence(missing)
    rig.faults.bit_errors(0.002, to_servos=False)
    samples = rig.ticks(400)
    assert not [each for each in samples if (abs(each.position - 2048) > REACH)[each.heard].any()]
    present = np.array(rig.reader.ids) != missing
    assert any(not each.heard[present].all() for each in samples), "nothing was disturbed"
    assert any(each.heard[present].all() for each in samples), "nothing was read"


def test_a_jump_is_believed_after_readings_in_a_row_however_old_the_last_one_is() -> None:
    rig = FeetechRig()
    rig.ticks(AGREE + 1)
    for pause in (0.0, 5.0):
        rig.clock.sleep_until(rig.clock.now() + pause)
        rig.servos.frozen[1] = 3000
        assert [bool(rig.tick().heard[1]) for _ in range(AGREE)] == [False] * (AGREE - 1) + [True]
        rig.servos.frozen[1] = None
        rig.ticks(AGREE)


def test_a_reading_after_a_gap_needs_a_second_one_that_agrees() -> None:
    rig = FeetechRig()
    rig.ticks(AGREE)
    rig.faults.drop(1, id=2)
    assert [bool(rig.tick().heard[1]) for _ in range(3)] == [False, False, True]
