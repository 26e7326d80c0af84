"""Dynamixel models of Protocol 1.0: number, registers, range, and figures of their pages. Pure.

Source of the figures: "Specifications" of the model's e-manual page, of MX those of the page with 2.0. An
AX-12W is limited to 54 rev/min in joint mode. Gain law, friction and armature of MX-64 and MX-106: measured
by Rhoban/bam (`bam/dynamixel/actuator.py`, duty 0.158 per rad of error and count of P gain), taken for the
MX-28 as well. With a compliance slope the output is full at that many counts of error (assumed).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import pi

from twind.exceptions import InvalidInput
from twind_drivers.virtual.servo_strength import MotorFigures, OperatingPoint

AX_RPM = 0.111  # per count of speed
MX_RPM = 0.114
DIVISOR = 4096 / (0.158 * 2 * pi * 1023)  # P gain per PWM count and count of error
HALF = 1024 * 360 / 300  # counts per turn of 1024 counts over 300°
EX = 4096 * 360 / 251  # of 4096 counts over 251°
STAND_IN = "AX-12A"  # model whose figures stand for those of models that no page gives any for
TWO = {30: "MX-28", 311: "MX-64", 321: "MX-106"}  # numbers with the table of Protocol 2.0
NEW_FIRMWARE = 39  # of an MX: it may have the table of Protocol 2.0


@dataclass(frozen=True, slots=True)
class Dynamixel1Model:
    """One model. `table`: `ax`, `mx` or `mx_current`; `turn`: counts per turn of the shaft.

    An MX has `(1.0)` in its name: the same servo with Protocol 2.0 belongs to another family.
    """

    name: str
    number: int
    table: str
    counts: int  # of its position, from 0
    turn: float
    hottest: float  # °C, register 11 as delivered
    volts: float  # V, recommended
    figures: MotorFigures | None

    @property
    def bulk_read(self) -> bool:
        """True if it answers bulk reads."""
        return self.table != "ax"

    @property
    def rpm(self) -> float:
        """Revolutions per minute of one count of speed."""
        return MX_RPM if self.bulk_read else AX_RPM

    def strength(self, volts: float) -> tuple[float, float] | None:
        """Return stall torque (N·m) and speed without load (rad/s) at a supply; None: no page gives them."""
        if self.figures is None:
            return None
        stall, speed, _ = self.figures.at(volts)
        return stall, speed


def share_per_radian(known: Dynamixel1Model, gain: float) -> float:
    """Return the share of the stall torque for each rad of error: of P gain (28), or compliance slope."""
    if known.bulk_read:
        return 4096 / (2 * pi * 1023) * gain / DIVISOR
    return known.turn / (2 * pi) / gain


Row = tuple[float, float, float, float]  # V, N·m, rev/min, A, as OperatingPoint


def _of(gear: float, *rows: Row, nominal: float) -> MotorFigures:
    points = tuple(OperatingPoint(*row) for row in rows)
    return MotorFigures(points=points, gear=gear, nominal=nominal, divisor=DIVISOR)


def models() -> Mapping[str, Dynamixel1Model]:
    """Return the known models by name."""
    ax12 = _of(254.0, (12.0, 1.5, 59.0, 1.5), nominal=11.1)
    ax12w = _of(32.0, (12.0, 0.2, 54.0, 1.4), nominal=11.1)
    ax18 = _of(254.0, (12.0, 1.8, 97.0, 2.2), nominal=11.1)
    rx28 = _of(193.0, (18.5, 3.7, 85.0, 1.9), nominal=14.8)
    rx64 = _of(200.0, (18.5, 5.3, 64.0, 2.6), nominal=14.8)
    ex106 = _of(184.0, (18.5, 10.9, 91.0, 7.0), nominal=14.8)
    mx28 = _of(193.0, (11.1, 2.3, 50.0, 1.3), (12.0, 2.5, 55.0, 1.4), (14.8, 3.1, 67.0, 1.7), nominal=12.0)
    mx64 = _of(200.0, (11.1, 5.5, 58.0, 3.9), (12.0, 6.0, 63.0, 4.1), (14.8, 7.3, 78.0, 5.2), nominal=12.0)
    mx106 = _of(225.0, (11.1, 8.0, 41.0, 4.8), (12.0, 8.4, 45.0, 5.2), (14.8, 10.0, 55.0, 6.3), nominal=12.0)
    mx64 = replace(mx64, friction=0.090, damping=0.012, armature=0.0120)
    mx106 = replace(mx106, friction=0.104, damping=0.035, armature=0.0266)
    rows = (
        Dynamixel1Model("AX-12A", 12, "ax", 1024, HALF, 70.0, 11.1, ax12),
        Dynamixel1Model("AX-12W", 300, "ax", 1024, HALF, 70.0, 11.1, ax12w),
        Dynamixel1Model("AX-18A", 18, "ax", 1024, HALF, 75.0, 11.1, ax18),
        Dynamixel1Model("RX-24F", 24, "ax", 1024, HALF, 80.0, 12.0, None),
        Dynamixel1Model("RX-28", 28, "ax", 1024, HALF, 80.0, 14.8, rx28),
        Dynamixel1Model("RX-64", 64, "ax", 1024, HALF, 80.0, 14.8, rx64),
        Dynamixel1Model("EX-106", 107, "ax", 4096, EX, 80.0, 14.8, ex106),
        Dynamixel1Model("MX-12W", 360, "mx", 4096, 4096.0, 80.0, 12.0, None),
        Dynamixel1Model("MX-28(1.0)", 29, "mx", 4096, 4096.0, 80.0, 12.0, mx28),
        Dynamixel1Model("MX-64(1.0)", 310, "mx_current", 4096, 4096.0, 80.0, 12.0, mx64),
        Dynamixel1Model("MX-106(1.0)", 320, "mx_current", 4096, 4096.0, 80.0, 12.0, mx106),
    )
    return {each.name: each for each in rows}


def model(name: str) -> Dynamixel1Model:
    """Return a model by its name. Raises InvalidInput that lists the names."""
    known = models()
    if name not in known:
        raise InvalidInput(f"{name!r} is no model of Protocol 1.0; known: {', '.join(sorted(known))}")
    return known[name]


def model_of(number: int) -> Dynamixel1Model | None:
    """Return the model of a model number; None: not known."""
    return next((each for each in models().values() if each.number == number), None)
