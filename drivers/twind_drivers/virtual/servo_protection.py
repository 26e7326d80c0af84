"""Self-protection of a servo: its supply, its heat, its load. Bits of register 70 by physics.

The manual names the errors, not their models ("Shutdown"). The numbers here are assumptions, chosen so that a
robot in normal use never reaches them. Encoder and electrical shock errors come on order only.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twind_drivers.dynamixel.control_tables import ControlTable
from twind_drivers.virtual.dynamixel_motor_figures import motor_figures
from twind_drivers.virtual.servo_strength import BEARABLE, Motors

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
# register 70
INPUT_VOLTAGE = 1
OVERHEATING = 4
ENCODER = 8
SHOCK = 16
OVERLOAD = 32
AMBIENT = 25.0  # °C
# °C of a blocked motor at rest: of the winding, of the case around it. An XM430's stall current is 2.3 A.
WARMTH = np.array([[26.45], [79.35]])
SLOWNESS = np.array([[12.0], [180.0]])  # s, their time constants
SAG = 0.05  # Ω of cable and supply, shared by the bus
# An XM430 held 0.94 A, 41 % of its stall current, for seconds only (DynamixelSDK #285), one with its current
# limited to 47 % got overload errors in a grip (jsk_aerial_robot #281). So a load r of the stall current
# tires it by r² - BEARABLE² a second, until TIRED; less rests it. Stalled it lasts 1 s, at half of that 7 s.
# Other models: as the share of the current that they bear, of the pages for some (`servo_strength`).
TIRED = 1.0 - BEARABLE**2
BROWN_OUT = 0.5  # of the nominal voltage: below it the controller stops
# V
NOMINAL = 12.0
NOMINAL_X330 = 5.0
NOMINAL_P = 24.0


def ampere(table: ControlTable) -> float:
    """A per raw current: 2.69 mA (XM, XH, X540), 1 mA (X330, P) and so on; 2.69 mA where none is measured."""
    return table.facts.ampere_per_count or 0.00269


def nominal(table: ControlTable) -> float:
    """V that the model is made for, by its voltage limit: 5 (XL330, XC330-M), 24 (P, XH-V), 12 (others)."""
    field = table.fields.get("max_voltage_limit")
    highest = (field.rule.default or 0) if field else 0  # 0.1 V; 0: not known
    if 0 < highest <= 70:
        return NOMINAL_X330
    return NOMINAL_P if highest > 240 else NOMINAL


class ServoProtection:
    """Voltage, temperature and load of m servos. Its owner calls `step` ten times a second."""

    def __init__(self, tables: Sequence[ControlTable], now: float = 0.0) -> None:
        """Begin at `AMBIENT` and the nominal voltage."""
        self.ampere = np.array([ampere(each) for each in tables])
        self.nominal = np.array([nominal(each) for each in tables])
        self.motors = Motors([motor_figures(each) for each in tables], self.nominal)
        self.source = float(self.nominal.max(initial=0.0))  # V, what feeds the bus
        self.own = self.nominal < self.source  # fed through a step-down converter of their own
        self.surroundings = np.full(len(tables), AMBIENT)
        self._warm = np.zeros((2, len(tables)))  # °C above the surroundings: winding, case
        self._drawn = 0.0  # A, all of them, from the supply
        self._tired = np.zeros(len(tables))
        self._weary = False  # is anyone tired?
        self._time = now
        self._span = -1.0
        self._kept = self._gained = np.zeros((2, 1))  # shares of the warmth in a step of `_span`
        self._hottest = np.full(len(tables), np.inf)
        self._highest = np.full(len(tables), np.inf)
        self._lowest = self._least = BROWN_OUT * self.nominal
        self.connector_volts = self._fed()
        self._lost = np.zeros(len(tables))  # V, in each one's own cable
        self._sense()

    def watch(self, hottest: Floats, lowest: Floats, highest: Floats) -> None:
        """Set the limits (m,) by registers 31 (°C), 34 and 32 (V)."""
        self._hottest = hottest
        self._lowest = lowest
        self._highest = highest

    def supply(self, volts: float) -> None:
        """Set the supply of the bus, V, also of the converters. Raises ValueError outside 0..60 V."""
        if not 0.0 <= volts <= 60.0:
            raise ValueError(f"supply: {volts} V is outside 0..60 V")
        self.source = float(volts)
        self.connector_volts = self._fed()
        self._sense()

    def _fed(self) -> Floats:
        """V at the connectors, but for the sag. A step-down converter passes on a supply below its output."""
        return np.where(self.own, np.minimum(self.nominal, self.source), self.source)

    def drop(self, row: int, volts: float) -> None:
        """Set the voltage lost in the cable to one servo, V. Raises ValueError outside 0..60 V."""
        if not 0.0 <= volts <= 60.0:
            raise ValueError(f"sag: {volts} V is outside 0..60 V")
        self._lost[row] = volts
        self._sense()

    def heat(self, row: int, celsius: float) -> None:
        """One servo and its surroundings are that warm from now on. Raises ValueError outside -40..200 °C."""
        if not -40.0 <= celsius <= 200.0:
            raise ValueError(f"heat: {celsius} °C is outside -40..200 °C")
        self.surroundings[row] = celsius
        self._warm[:, row] = 0.0
        self._sense()

    @property
    def supply_share(self) -> Floats:
        """Voltage at the servos, as a share of the nominal one (m,): the value of 100 % PWM."""
        return np.asarray(np.maximum(self.volts, 0.0) / self.nominal)

    @property
    def dark(self) -> Bools:
        """Servos (m,) with too little voltage for the controller."""
        return np.asarray(~(self.volts >= self._least))

    def rest(self, row: int) -> None:
        """A boot forgets how tired the servo was, not how warm it is."""
        self._tired[row] = 0.0

    def step(self, now: float, current: Floats, duty: Floats | float = 1.0) -> bool:
        """Let time pass until `now` (s) with this raw current (m,). Is there anything to react to?

        `duty` (m,): share of the time in which the motor's current comes from the supply.
        """
        span = max(now - self._time, 0.0)
        self._time = max(now, self._time)
        if abs(span - self._span) > 1e-9:
            self._span = span
            self._kept = np.exp(-span / SLOWNESS)
            self._gained = WARMTH * (1.0 - self._kept)
        amperes = np.abs(current) * self.ampere
        self._drawn = float(np.add.reduce(amperes * duty))
        self._warm *= self._kept
        load = amperes / self.motors.bearable
        self._warm += self._gained * (BEARABLE * load) ** 2
        self._sense()
        if self._weary or np.count_nonzero(load > 1.0):
            self._tire(load, span)
        fine = (self.volts >= self._lowest) & (self.volts >= self._least) & (self.volts <= self._highest)
        return self._weary or bool(np.count_nonzero(fine & (self.celsius < self._hottest)) < len(fine))

    def errors(self) -> NDArray[np.int64]:
        """Bits of register 70 (m,) that hold now."""
        fine = (self.volts >= self._lowest) & (self.volts <= self._highest)
        bits = np.where(fine, 0, INPUT_VOLTAGE) + np.where(self.celsius < self._hottest, 0, OVERHEATING)
        return np.asarray(bits + np.where(self._tired < TIRED - 1e-9, 0, OVERLOAD), np.int64)

    def _sense(self) -> None:
        """Update the sensor values (m,): °C, and V with the sag by the current of all servos.

        A converter keeps its voltage.
        """
        self.celsius = self.surroundings + self._warm[0] + self._warm[1]
        self.volts = self.connector_volts - np.where(self.own, 0.0, SAG * self._drawn) - self._lost

    def _tire(self, load: Floats, span: float) -> None:
        effort = (load * BEARABLE) ** 2 - BEARABLE**2
        self._tired = np.clip(self._tired + effort * span, 0.0, TIRED)
        self._weary = bool(np.count_nonzero(self._tired))
