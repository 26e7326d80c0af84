"""Permitted commands of each actuator of a CAN bus: a motor, and a bus of them."""

from dataclasses import dataclass
from math import ceil, floor, pi

TURN = 16384  # counts a turn of the output, in the calibration file
FIELD = 65535  # steps of a 16-bit field
FAMILIES = ("damiao", "cubemars", "robstride", "odrive")


@dataclass(frozen=True)
class Motor:
    """One actuator. Words are what its goals are made of: fields of 16 bits; of an ODrive counts."""

    id: int
    name: str
    family: str
    reply: int  # id that a Damiao answers on
    position: float  # rad, span of the position field
    velocity: float  # rad/s
    torque: float  # N·m
    lower: int  # word: the smallest goal
    upper: int
    speed: float  # words/s
    brake: float  # words/s²
    rate: float  # rad/s, the same as `speed`
    push: float  # N·m, the largest feed-forward
    watched: bool  # has a watchdog that can be read back over the bus
    slack: float  # words that rounding may add to a step


@dataclass(frozen=True)
class CanLimits:
    """Limits of one bus. `servos` by id."""

    bus: str
    period: float  # s
    baud: int
    support: str
    servos: dict[int, Motor]


def word(family: str, span: float, angle: float) -> float:
    """The exact word of an angle (rad)."""
    if family == "odrive":
        return angle / (2.0 * pi) * TURN
    return (angle + span) * FIELD / (2.0 * span)


def motor(
    id: int,
    name: str,
    family: str,
    spans: tuple[float, float, float],
    ends: tuple[float, float],
    rate: float,
    acceleration: float,
    *,
    reply: int | None = None,
    push: float = 0.0,
) -> Motor:
    """From angles (rad) and rates (rad/s, rad/s²) at the actuator. Raises ValueError."""
    if family not in FAMILIES:
        raise ValueError(f"{name}: family {family!r}; known: {', '.join(FAMILIES)}")
    position, velocity, torque = spans
    each = word(family, position, 1.0) - word(family, position, 0.0)  # words a rad
    lower = word(family, position, ends[0])
    upper = word(family, position, ends[1])
    if not lower < upper or not rate > 0.0 or not acceleration > 0.0 or not each > 0.0:
        raise ValueError(f"{name}: ends {ends}, rate {rate}, acceleration {acceleration}, span {position}")
    return Motor(
        id=id,
        name=name,
        family=family,
        reply=id if reply is None else reply,
        position=position,
        velocity=velocity,
        torque=torque,
        lower=floor(lower + 1e-9),
        upper=ceil(upper - 1e-9),
        speed=rate * each,
        brake=acceleration * each,
        rate=rate,
        push=push,
        watched=family in ("damiao", "robstride"),
        slack=2.0 * pi / TURN * each if family != "odrive" else 0.0,  # a count, rounded before the field is
    )
