"""Meaning of a frame to an actuator, and of one from it. No state; only the form is judged."""

from typing import NamedTuple

from tests.proof.busmon.can.text import Malformed


class Act(NamedTuple):
    """One frame to one motor.

    `kind`: goal, soft (a command without stiffness: its place counts for nothing),
    limp (without damping and torque too; of a CubeMars, damped towards no speed), on, off, clear, read, ask,
    write (of the watchdog: `ticks` s), set (of something else that may be set), wrong (`why`: W2).
    """

    kind: str
    id: int
    word: int = 0
    rate: float = 0.0  # rad/s that a goal feeds forward
    push: float = 0.0  # N·m that it feeds forward
    seconds: float = -1.0  # of the watchdog that is written
    why: str = ""


class MotorReply(NamedTuple):
    """Content of one frame of a motor."""

    id: int
    word: int | None = None  # where it is
    on: bool | None = None
    alert: bool | None = None
    seconds: float | None = None  # its watchdog, as it was read


def forbidden(what: str, id: int) -> Malformed:
    """W8: a frame that changes what a motor is or where its zero is."""
    return Malformed(f"{what} to {id}")


def sized(data: bytes, size: int, what: str) -> bytes:
    """Raises Malformed: another length."""
    if len(data) != size:
        raise Malformed(f"{what} with {len(data)} bytes, not {size}")
    return data


def field(bits: int, width: int, span: float) -> float:
    """A field over a symmetric span, in its unit."""
    return bits * 2.0 * span / ((1 << width) - 1) - span
