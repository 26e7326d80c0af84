"""Frames for the tests of the CAN codecs: written by hand, and at random."""

from collections.abc import Sequence

import numpy as np
from hypothesis import strategies as st

from twind_drivers.bus import Floats
from twind_drivers.can.actuator_family import ActuatorFamily, FieldRanges
from twind_drivers.ports.frame import ERROR, EXTENDED, FRAME, REMOTE, Frames, payload

GAINS = (500.0, 5.0)


def column(*values: float) -> Floats:
    return np.array(values, np.float64)


def ranges(count: int, position: float = 12.5, velocity: float = 30.0, torque: float = 10.0) -> FieldRanges:
    return FieldRanges(*(np.full(count, value) for value in (position, velocity, torque, *GAINS)))


def frame(id: int, data: str | bytes = b"", size: int | None = None) -> Frames:
    """One frame; `data` as hex text or bytes."""
    octets = bytes.fromhex(data) if isinstance(data, str) else data
    made = np.zeros(1, FRAME)
    made["id"] = id
    made["data"][0, : len(octets)] = np.frombuffer(octets, np.uint8)
    made["size"] = len(octets) if size is None else size
    return made


def wire(frames: Frames) -> list[tuple[int, str]]:
    """Id without flags and payload in hex, of each."""
    return [(int(one["id"]) & 0x1FFF_FFFF, payload(one).hex(" ").upper()) for one in frames]


def noise(ids: Sequence[int]) -> st.SearchStrategy[Frames]:
    """Up to 80 frames of any id, size and content; half of them of `ids`, so that some nearly fit."""
    return st.integers(0, 2**32 - 1).map(lambda seed: noise_of(np.random.default_rng(seed), ids))


def noise_of(chance: np.random.Generator, ids: Sequence[int], most: int = 80) -> Frames:
    """One such batch of up to `most`."""
    count = int(chance.integers(0, most + 1))
    made = np.frombuffer(chance.bytes(count * FRAME.itemsize), FRAME).copy()
    near = chance.random(count) < 0.5
    flags = chance.choice((0, 0, 0, 0, EXTENDED, REMOTE, ERROR), count).astype(np.uint32)
    made["id"][near] = (chance.choice(np.array(ids, np.uint32), count) | flags)[near]
    made["size"][chance.random(count) < 0.7] = 8
    few = np.array((0, 1, 0x0F, 0x33, 0x55, 0x7F, 0xCC, 0xFF), np.uint8)
    plain = chance.random(count) < 0.5
    made["data"][plain] = chance.choice(few, (count, 8))[plain]
    return made


def decode_all(family: ActuatorFamily, frames: Frames) -> None:
    """Every decoder on `frames`: none raises, all are of one length, and nothing of the frames is changed."""
    before = frames.copy()
    feedback, told = family.feedback(frames)
    answers, answered = family.decode_register_replies(frames)
    commands = family.commanded_rows(frames)
    commanded = family.decode_commanded_position(frames)
    count = len(frames)
    assert told.shape == answered.shape == commands.shape == commanded.shape == (count,)
    columns = (feedback.rows, feedback.position, feedback.velocity, feedback.effort, feedback.enabled)
    for array in (*columns, feedback.fault, feedback.temperature, feedback.voltage):
        assert array.shape == (int(told.sum()),)
    members = range(len(family.ids))
    assert np.isin(feedback.rows, members).all()
    assert np.isin(commands, (-1, *members)).all()
    assert all(answer.row in members and len(answer.data) == 4 for answer in answers)
    assert (before == frames).all()
    assert not np.isinf(np.concatenate([feedback.position, feedback.velocity, feedback.effort])).any()
    assert (np.isnan(commanded) | (commands >= 0)).all()
