"""Operating modes: each device in its own unit, mixed freely on one bus, each within its own fence."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.dynamixel_rig import FAST, SYNC, Bench
from tests.support.examples import examples
from twind_drivers.bus import DeviceRefused, GroupWriteBatch, WireRangeError, WriteRequest
from twind_drivers.dynamixel.control_tables import number_of, table
from twind_drivers.dynamixel.dynamixel_writer import DynamixelWriter
from twind_drivers.dynamixel.operating_modes import MODES, block, fences, mode_of

WIDE = 1_048_575
CAP = 500
# The bounds that a servo itself has in each mode (e-manual, XM430-W350: registers 102, 104, 116).
BOUNDS = {0: (-1193, 1193), 1: (-1023, 1023), 3: (0, 4095), 4: (-WIDE, WIDE), 5: (-WIDE, WIDE)}
REGISTER = {0: (102, 2), 1: (104, 4), 3: (116, 4), 4: (116, 4), 5: (116, 4)}
GOALS = {
    mode: st.one_of(st.integers(*ends), st.sampled_from([ends[0], ends[1], 0]))
    for mode, ends in BOUNDS.items()
}
STUFFED = st.just(-131_073)  # FF FF FD FF: the one position that needs stuffing


def bench(modes: list[int], ids: list[int] | None = None, **more: Any) -> Bench:
    """A bus of these modes, each with the widest bounds that it has."""
    ends = [BOUNDS[mode] for mode in modes]
    return Bench(
        ids or list(range(1, len(modes) + 1)),
        **{
            "modes": modes,
            "lower": np.array([low for low, _ in ends]),
            "upper": np.array([high for _, high in ends]),
            "current_caps": [CAP if mode == 5 else None for mode in modes],
            **more,
        },
    )


# --------------------------------------------------------------------------------- an independent decoder


def crc(data: bytes) -> int:
    """CRC-16 with polynomial 8005 from 0, a bit at a time (e-manual, "CRC")."""
    value = 0
    for byte in data:
        for bit in range(7, -1, -1):
            out = (value >> 15) ^ (byte >> bit & 1)
            value = (value << 1 & 0xFFFF) ^ (0x8005 if out else 0)
    return value


def decode(wire: bytes) -> list[tuple[int, int, dict[int, int]]]:
    """(address, size, {id: word}) of each sync write; nothing else may stand in `wire`."""
    found = []
    while wire:
        assert wire[:5] == b"\xff\xff\xfd\x00\xfe"
        end = 7 + wire[5] + 256 * wire[6]
        assert crc(wire[: end - 2]) == wire[end - 2] + 256 * wire[end - 1]
        body = []
        run = 0
        for byte in wire[7 : end - 2]:
            if run == 3:  # after FF FF FD one FD is taken out
                assert byte == 0xFD
                run = 0
                continue
            body.append(byte)
            run = 3 if run == 2 and byte == 0xFD else min(run + 1, 2) if byte == 0xFF else 0
        assert body[0] == 0x83
        address = body[1] + 256 * body[2]
        size = body[3] + 256 * body[4]
        rows = body[5:]
        assert len(rows) % (size + 1) == 0
        words = {}
        for at in range(0, len(rows), size + 1):
            word = sum(byte << 8 * place for place, byte in enumerate(rows[at + 1 : at + 1 + size]))
            assert rows[at] not in words
            words[rows[at]] = word - (1 << 8 * size) if word >> (8 * size - 1) else word
        found.append((address, size, words))
        wire = wire[end:]
    return found


@st.composite
def mixes(draw: st.DrawFn) -> tuple[list[int], list[int], list[int]]:
    """Ids, their modes, a goal inside the bounds of each."""
    ids = draw(st.lists(st.integers(0, 252), min_size=1, max_size=6, unique=True))
    modes = [draw(st.sampled_from(sorted(MODES))) for _ in ids]
    return ids, modes, [draw(GOALS[mode] | STUFFED if mode in (4, 5) else GOALS[mode]) for mode in modes]


@given(mixes())
@examples(60)
def test_encoded_goals_decode_unchanged_with_one_packet_per_register(
    mix: tuple[list[int], list[int], list[int]],
) -> None:
    ids, modes, goals = mix
    bus = bench(modes, ids)
    bus.run(bus.writer.prepare(np.array([2000] * len(ids))))
    bus.writer.goals(np.array(goals))
    before = len(bus.wire.writes)
    packets = decode(bus.reader.line.goals)
    bus.cycle()
    assert len(bus.wire.writes) == before + 1  # goals and the next request in one system call
    assert [(address, size) for address, size, _ in packets] == list(
        dict.fromkeys(REGISTER[mode] for mode in modes)
    )
    for id, mode, goal in zip(ids, modes, goals, strict=True):
        assert [words[id] for address, _, words in packets if id in words] == [goal]
        assert bus.servos.get(id, *REGISTER[mode]) == goal


@given(mixes(), st.data())
@examples(60)
def test_a_goal_outside_its_bounds_is_never_sent_and_leaves_nothing_pending(
    mix: tuple[list[int], list[int], list[int]], data: st.DataObject
) -> None:
    ids, modes, goals = mix
    bus = bench(modes, ids)
    bus.run(bus.writer.prepare(np.array([2000] * len(ids))))
    place = data.draw(st.integers(0, len(ids) - 1))
    low, high = BOUNDS[modes[place]]
    beyond = st.sampled_from([low - 1, high + 1, low - 65_536, high + 65_536, 2**32, -(2**40)])
    bus.writer.goals(np.array(goals))
    goals[place] = data.draw(beyond)
    with pytest.raises(WireRangeError, match=rf"id {ids[place]}: goal {goals[place]} outside {low}..{high}"):
        bus.writer.goals(np.array(goals))
    bus.cycle()
    assert bus.addresses() == [(FAST, 126)]
    before = len(bus.wire.writes)
    with pytest.raises(WireRangeError):
        bus.run(bus.writer.write_goals(np.array(goals)))
    assert len(bus.wire.writes) == before


# --------------------------------------------------------------------------------- before torque


def test_speeds_and_currents_are_only_zero_until_their_limits_have_been_read() -> None:
    bus = bench([1, 0])
    with pytest.raises(WireRangeError) as clamp:
        bus.writer.goals(np.array([1, 0]))
    assert (clamp.value.id, clamp.value.value, clamp.value.lower, clamp.value.upper) == (1, 1, 0, 0)
    bus.writer.goals(np.array([0, 0]))
    bus.run(bus.writer.prepare(np.array([0, 0])))
    bus.writer.goals(np.array([1023, -1193]))


def test_a_limit_register_narrows_what_may_be_sent() -> None:
    # e-manual: goal velocity (104) is limited by 44, goal current (102) by 38
    bus = bench([1, 0])
    bus.servos.put(1, 44, 200, 4)
    bus.servos.put(2, 38, 300, 2)
    bus.run(bus.writer.prepare(np.array([0, 0])))
    bus.writer.goals(np.array([200, -300]))
    for goals in ([201, 0], [0, -301]):
        with pytest.raises(WireRangeError):
            bus.writer.goals(np.array(goals))
    with pytest.raises(WireRangeError):
        bus.writer.begin(WriteRequest({1: (201).to_bytes(4, "little")}, 104), 0.0)


def test_speeds_and_currents_are_prepared_at_zero_whatever_stood_there() -> None:
    bus = bench([1, 0, 3])
    bus.servos.put(1, 104, 400, 4)
    bus.servos.put(2, 102, -400, 2)
    bus.run(bus.writer.prepare(np.array([1500, 1500, 1500])))
    assert bus.run(bus.writer.read_goals()).tolist() == [0, 0, 1500]
    assert (bus.servos.get(1, 116, 4), bus.servos.get(2, 116, 4)) == (0, 0)


@pytest.mark.parametrize("goals", [[2000], [2000, 0, 0], [2000.0, 0.0], [np.nan, 0.0], []])
def test_goals_of_another_shape_are_not_stretched_to_fit(goals: list[float]) -> None:
    bus = bench([3, 1])
    for script in (bus.writer.prepare, bus.writer.write_goals):
        with pytest.raises(ValueError, match="2 whole ticks needed"):
            bus.run(script(np.array(goals)))
    assert all(each.instruction != SYNC for each in bus.servos.seen)


@pytest.mark.parametrize(("mode", "what"), [(1, "goal velocity"), (0, "goal current")])
def test_torque_goes_on_only_after_speeds_and_currents_read_back_zero(mode: int, what: str) -> None:
    bus = bench([3, mode])
    bus.servos.put(2, *REGISTER[mode][:1], 7, REGISTER[mode][1])
    with pytest.raises(DeviceRefused, match=rf"id 2: {what}.*needs 00.*reads 07"):
        bus.run(bus.writer.torque(True))
    assert [bus.servos.get(id, 64, 1) for id in (1, 2)] == [0, 0]
    bus.run(bus.writer.torque(False))  # off is never refused
    bus.run(bus.writer.prepare(np.array([2000, 0])))
    bus.run(bus.writer.torque(True))
    assert [bus.servos.get(id, 64, 1) for id in (1, 2)] == [1, 1]


def test_the_cap_of_current_based_position_is_written_before_the_goal_and_read_back() -> None:
    bus = bench([5, 3])
    bus.servos.put(1, 102, 1193, 2)
    bus.run(bus.writer.prepare(np.array([2000, 2000])))
    (burst,) = (
        bus.addresses(place) for place in range(len(bus.wire.writes)) if (SYNC, 98) in bus.addresses(place)
    )
    assert burst == [(SYNC, 98), (SYNC, 102), (SYNC, 116), (SYNC, 98)]
    assert (bus.servos.get(1, 102, 2), bus.servos.get(2, 102, 2)) == (CAP, 0)
    bus.servos.frozen = {1: {102, 103}}
    bus.servos.put(1, 102, 1193, 2)
    with pytest.raises(DeviceRefused, match="id 1: goal current, the cap of mode 5"):
        bus.run(bus.writer.prepare(np.array([2000, 2000])))


def test_a_cap_beyond_the_current_limit_is_refused_with_that_register_named() -> None:
    bus = bench([5])
    bus.servos.put(1, 38, 400, 2)
    bus.servos.frozen = {1: {102, 103}}  # a servo drops what is beyond its limit (error 6)
    with pytest.raises(DeviceRefused, match=r"500 is beyond its Current Limit 400 \(register 38\)"):
        bus.run(bus.writer.prepare(np.array([2000])))


def test_a_lowered_pwm_beside_the_cap_is_refused() -> None:
    bus = bench([5])
    bus.servos.put(1, 100, 300, 2)
    with pytest.raises(DeviceRefused, match=r"goal PWM, at its limit \(100\): needs 75 03, reads 2c 01"):
        bus.run(bus.writer.prepare(np.array([2000])))
    assert bus.servos.get(1, 116, 4) == 0


@pytest.mark.parametrize(("wanted", "found"), [(3, 4), (4, 3), (5, 3), (1, 3), (0, 5), (3, 16)])
def test_a_device_in_another_mode_is_not_prepared(wanted: int, found: int) -> None:
    bus = bench([wanted, 3])
    bus.servos.put(1, 11, found, 1)
    with pytest.raises(DeviceRefused, match=rf"operating mode \(11\) is {found} .*{wanted} .*register 11"):
        bus.run(bus.writer.prepare(np.array([2000, 2000])))
    assert all(each.instruction != SYNC for each in bus.servos.seen)


def test_profiles_are_ours_for_positions_and_as_given_for_speeds() -> None:
    # e-manual, Profile Acceleration (108): used in all modes but current control and PWM control
    bus = bench([1, 1, 3, 0], accelerations=[40, None, None, None])
    for id in bus.ids:
        bus.servos.put(id, 108, 9, 4)
        bus.servos.put(id, 112, 8, 4)
    bus.run(bus.writer.prepare(np.array([0, 0, 2000, 0])))
    assert [bus.servos.get(id, 108, 4) for id in bus.ids] == [40, 9, 0, 9]
    assert [bus.servos.get(id, 112, 4) for id in bus.ids] == [8, 8, 0, 8]
    bus.servos.put(1, 108, 9, 4)
    bus.servos.frozen = {1: {108}}
    with pytest.raises(DeviceRefused, match="id 1: profile acceleration"):
        bus.run(bus.writer.prepare(np.array([0, 0, 2000, 0])))


def test_position_limits_explain_a_goal_that_does_not_stay() -> None:
    # e-manual, Min/Max Position Limit (52, 48): a goal beyond them is refused, which no sync write tells
    bus = bench([3])
    bus.servos.put(1, 52, 100, 4)
    bus.servos.put(1, 48, 2500, 4)
    bus.servos.frozen = {1: set(range(116, 120))}
    with pytest.raises(
        DeviceRefused, match=r"goal 2600 is outside its position limits 100..2500 \(registers 52, 48\)"
    ):
        bus.run(bus.writer.write_goals(np.array([2600])))


# --------------------------------------------------------------------------------- X and P on one bus


@pytest.fixture
def families() -> Bench:
    """Ids 1 and 3 are XM430, 2 and 4 PH54: RAM registers at other addresses (e-manual, PH54-200-S500)."""
    bus = Bench((1, 2, 3, 4))
    for id in (2, 4):
        bus.reader.tables[id] = table(2020)
    bus.writer = DynamixelWriter(
        bus.reader,
        lower=np.array([0, -500_000, 0, -500_000]),
        upper=np.array([4095, 500_000, 4095, 500_000]),
        gains=[(640, 0, 0)] * 4,
    )
    return bus


HERE = np.array([2000, -400_000, 2100, 131_072])


def test_each_family_is_written_at_its_own_addresses_in_one_system_call(families: Bench) -> None:
    families.writer.goals(HERE)
    assert decode(families.reader.line.goals) == [
        (116, 4, {1: 2000, 3: 2100}),
        (564, 4, {2: -400_000, 4: 131_072}),
    ]
    families.cycle()
    assert [
        families.servos.get(id, at, 4) for id, at in ((1, 116), (2, 564), (3, 116), (4, 564))
    ] == HERE.tolist()


def test_a_cut_reaches_every_family_twice(families: Bench) -> None:
    for id, at in ((1, 64), (2, 512), (3, 64), (4, 512)):
        families.servos.put(id, at, 1, 1)
    families.writer.goals(HERE)
    families.writer.cut()
    families.cycle()
    assert families.addresses() == [(SYNC, 64), (SYNC, 512), (SYNC, 64), (SYNC, 512), (FAST, 126)]
    assert [families.servos.get(id, at, 1) for id, at in ((1, 64), (2, 512), (3, 64), (4, 512))] == [0] * 4


def test_families_are_prepared_aimed_and_switched_together(families: Bench) -> None:
    families.run(families.writer.prepare(HERE))
    (burst,) = (
        families.addresses(place)
        for place in range(len(families.wire.writes))
        if (SYNC, 98) in families.addresses(place)
    )
    assert burst == [(SYNC, at) for at in (98, 546, 116, 564, 98, 546)]
    assert [families.servos.get(id, at, 1) for id, at in ((1, 98), (2, 546), (3, 98), (4, 546))] == [5] * 4
    assert [families.servos.get(id, at, 2) for id, at in ((1, 84), (2, 532), (3, 84), (4, 532))] == [640] * 4
    families.run(families.writer.torque(True))
    assert [families.servos.get(id, at, 1) for id, at in ((1, 64), (2, 512), (3, 64), (4, 512))] == [1] * 4
    families.run(families.writer.write_goals(HERE + 5))
    assert families.run(families.writer.read_goals()).tolist() == (HERE + 5).tolist()
    families.servos.frozen = {4: set(range(564, 568))}
    with pytest.raises(DeviceRefused, match=r"id 4: goal position \(564\)"):
        families.run(families.writer.write_goals(HERE))
    with pytest.raises(WireRangeError, match="read-only address"):
        families.writer.begin(WriteRequest({1: b"\1", 2: b"\1"}, 512), 0.0)


# --------------------------------------------------------------------------------- what may not be


@pytest.mark.parametrize(
    ("mode", "order"),
    [
        (3, WriteRequest({1: bytes(4)}, 104)),  # a speed to a device that is not in velocity mode
        (1, WriteRequest({1: (2000).to_bytes(4, "little")}, 116)),
        (0, WriteRequest({1: (2000).to_bytes(4, "little")}, 116)),
        (0, WriteRequest({1: (-1194).to_bytes(2, "little", signed=True)}, 102)),
        (5, WriteRequest({1: (CAP + 1).to_bytes(2, "little")}, 102)),
        (5, WriteRequest({1: (-1).to_bytes(2, "little", signed=True)}, 102)),
        (5, WriteRequest({1: bytes(4)}, 100)),  # a current hidden behind a PWM
        (
            5,
            GroupWriteBatch(
                (WriteRequest({1: b"\0"}, 98), WriteRequest({1: (WIDE + 1).to_bytes(4, "little")}, 116))
            ),
        ),
    ],
)
def test_a_goal_register_of_another_mode_takes_no_byte(
    mode: int, order: WriteRequest | GroupWriteBatch
) -> None:
    bus = bench([mode])
    bus.run(bus.writer.prepare(np.array([0])))
    before = len(bus.wire.writes)
    with pytest.raises(WireRangeError):
        bus.writer.begin(order, 0.0)
    assert len(bus.wire.writes) == before


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"modes": [16]}, "operating mode 16 is not driven here; known are 0 current, 1 velocity"),
        ({"modes": [2]}, "operating mode 2 is not driven"),
        ({"modes": [5]}, r"mode 5 needs a current cap of 1\.\.1193 counts, got None"),
        ({"modes": [5], "current_caps": [0]}, "got 0"),
        ({"modes": [5], "current_caps": [1194]}, "got 1194"),
        ({"modes": [3], "current_caps": [100]}, "belongs to mode 5, not to mode 3"),
        ({"modes": [1]}, r"bounds 1000\.\.3000 of mode 1 must hold 0"),
        ({"modes": [1], "lower": np.array([-1024])}, r"leave -1023\.\.1023, the range of"),
        ({"modes": [0], "lower": np.array([-1]), "upper": np.array([1194])}, r"leave -1193\.\.1193"),
        ({"modes": [4], "upper": np.array([WIDE + 1])}, r"leave -1048575\.\.1048575"),
        ({"modes": [3], "accelerations": [5]}, "profile acceleration 5 belongs to mode 1"),
        ({"modes": [1], "lower": np.array([0]), "accelerations": [32768]}, r"0\.\.32767"),
        ({"modes": [3, 3]}, r"one value for each of 1 devices needed, got \[3, 3\]"),
    ],
)
def test_a_writer_that_could_not_be_driven_does_not_come_into_being(more: dict[str, Any], words: str) -> None:
    reader = bench([3]).reader
    with pytest.raises(ValueError, match=words):
        DynamixelWriter(reader, **{"lower": np.array([1000]), "upper": np.array([3000]), **more})


@pytest.mark.parametrize("mode", [0, 5])
def test_a_model_without_current_control_has_no_mode_that_needs_it(mode: int) -> None:
    # e-manual, XL430-W250: no current limit (38), no goal current (102)
    with pytest.raises(ValueError, match="XL430-W250 has no "):
        mode_of("here", table(number_of("XL430-W250")), mode)


@pytest.mark.parametrize("mode", sorted(MODES))
def test_every_goal_register_of_a_model_has_a_fence_in_every_mode(mode: int) -> None:
    registers = table(1020)
    found = fences(registers, MODES[mode], -5, 5, CAP if mode == 5 else None)
    goals = ("goal_current", "goal_velocity", "goal_position")
    assert set(found) == {block(registers, name) for name in goals}
    assert found[block(registers, MODES[mode].goal)] == (-5, 5)
