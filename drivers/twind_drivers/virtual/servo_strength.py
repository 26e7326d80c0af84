"""Strength of a virtual servo's motor: figures of its page, and what they give at a supply voltage.

Any family may use this module. It knows no model and no register.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
RAD_S = 2.0 * pi / 60.0  # rad/s per rev/min
# Least friction of a gear, as a share of stall torque and of back-EMF: 0.05 N·m and 0.01 N·m·s/rad of an
# XM430-W350, whose page states neither. Fits of other servos found 1.2 % (MX-106) to 3.5 % (XL330).
DRY = 0.0122
VISCOUS = 0.0117
BEARABLE = 0.35  # of the stall current, for ever; see `servo_protection`


@dataclass(frozen=True, slots=True)
class OperatingPoint:
    """One row of a page, at the output shaft."""

    volts: float
    stall: float  # N·m
    rpm: float  # without load
    amperes: float  # blocked


@dataclass(frozen=True, slots=True, kw_only=True)
class MotorFigures:
    """Figures of one model. What is None follows from the stall figures."""

    points: tuple[OperatingPoint, ...]  # by rising voltage
    gear: float  # motor turns per turn of the output
    nominal: float  # V, recommended
    divisor: float = 128.0  # PWM counts per tick of error: gain register / divisor
    bearable: float | None = None  # A, for ever
    friction: float | None = None  # N·m, dry, at the output
    damping: float | None = None  # N·m·s/rad, at the output
    load_friction: float = 0.0  # N·m of dry friction per (N·m)² that the gear carries
    armature: float = 0.0  # kg·m², of the motor at the output; 0: not known

    def at(self, volts: float) -> tuple[float, float, float]:
        """Return stall torque (N·m), no-load speed (rad/s) and stall current (A) at `volts`.

        Each is proportional to the voltage. The factor is that of the points, interpolated between them.
        """
        stall, speed, amperes = self.curve(np.array([volts]))[:, 0].tolist()
        return stall, speed, amperes

    def curve(self, volts: Floats) -> Floats:
        """Return the same at k voltages, (3, k)."""
        known = [each.volts for each in self.points]
        given = np.array([(each.stall, each.rpm * RAD_S, each.amperes) for each in self.points]).T
        return np.array([volts * np.interp(volts, known, each) for each in given / known])


@dataclass(frozen=True, slots=True)
class MotorStrength:
    """Strength of m motors at their supply; a number is that of all. The defaults: XM430-W350 at 12 V.

    Torque and speed are per unit of supply: multiplied by its share of the nominal voltage they are real.
    """

    stall: Floats | float = 4.1  # N·m, blocked, at full PWM
    speed: Floats | float = 46.0 * RAD_S  # rad/s, without load, at full PWM
    torque_constant: Floats | float = 4.1 / 2.3  # N·m per A
    divisor: Floats | float = 128.0
    friction: Floats | float = DRY * 4.1  # N·m
    damping: Floats | float = VISCOUS * 4.1 / (46.0 * RAD_S)  # N·m·s/rad
    load_friction: Floats | float = 0.0
    armature: Floats | float = 0.0  # kg·m²


class Motors:
    """Motors of m servos. Arrays are (m,)."""

    def __init__(self, figures: Sequence[MotorFigures], nominal: Floats) -> None:
        """`nominal`: V that a supply of 1 means, for each."""
        alike: dict[int, list[int]] = {}  # servos with the same figures
        for row, each in enumerate(figures):
            alike.setdefault(id(each), []).append(row)
        self._kinds = [(figures[rows[0]], np.array(rows, np.intp)) for rows in alike.values()]
        self._nominal = nominal
        stall, speed, self.stall_current = self._at(nominal)
        self.bearable = _given([each.bearable for each in figures], BEARABLE * self.stall_current)  # A
        self._friction = _given([each.friction for each in figures], DRY * stall)
        self._damping = _given([each.damping for each in figures], VISCOUS * stall / speed)
        self._divisor, self._load, self._armature = (
            np.array([getattr(each, key) for each in figures], np.float64)
            for key in ("divisor", "load_friction", "armature")
        )

    def strength(self, supply: Floats) -> MotorStrength:
        """Return the strength at `supply` (m,), share of the nominal voltage."""
        share = np.maximum(supply, 1e-6)
        stall, speed, amperes = self._at(share * self._nominal)
        return MotorStrength(
            stall=stall / share,
            speed=speed / share,
            torque_constant=stall / amperes,
            divisor=self._divisor,
            friction=self._friction,
            damping=self._damping,
            load_friction=self._load,
            armature=self._armature,
        )

    def _at(self, volts: Floats) -> Floats:
        found = np.zeros((3, volts.size))
        for figures, rows in self._kinds:
            found[:, rows] = figures.curve(volts[rows])
        return found


def _given(values: Sequence[float | None], usual: Floats) -> Floats:
    """Return the values; `usual` (m,) for None."""
    pairs = zip(values, usual.tolist(), strict=True)
    return np.array([other if value is None else value for value, other in pairs], np.float64)
