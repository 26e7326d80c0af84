"""What a servo measures and shows: the present registers, filled from its muscles."""

import numpy as np
from numpy.typing import NDArray

from twind_drivers.virtual.memory import Memory
from twind_drivers.virtual.muscles import Muscles

Floats = NDArray[np.float64]
FIRST, LAST = "realtime_tick", "present_temperature"
AMBIENT = 25.0  # °C
WARMTH = 20.0  # °C per A² at rest, reached with WARM_TIME
WARM_TIME = 180.0  # s
SAG = 0.05  # Ω of cable and supply, shared by the bus
AMPERE = 0.00269  # A per raw current: exact for the XM and XH, 2.7 times too much for the X330
IN_POSITION = 20.0  # ticks


class Readings:
    """Columns of the registers that only the servo itself writes. One refresh serves all servos."""

    def __init__(self, memory: Memory, muscles: Muscles) -> None:
        self._muscles = muscles
        self._tick = memory.column("realtime_tick", 2)
        self._moving = memory.column("moving", 1)
        self._moving_status = memory.column("moving_status", 1)
        self._pwm = memory.column("present_pwm", 2, signed=True)
        sensed = [key for key in ("present_current", "present_load") if any(key in t for t in memory.tables)]
        self._efforts = [memory.column(key, 2, signed=True) for key in sensed]
        self._velocity = memory.column("present_velocity", 4, signed=True)
        self.position = memory.column("present_position", 4, signed=True)
        self._trajectory = memory.column("position_trajectory", 4, signed=True)
        self._voltage = memory.column("present_input_voltage", 2)
        self._temperature = memory.column("present_temperature", 1)
        self._threshold = memory.column("moving_threshold", 4)
        count = len(memory.raw)
        self.origin = np.zeros(count)  # s, when each servo was powered on
        self.supply = np.array([50.0 if 1190 <= t.number <= 1240 else 120.0 for t in memory.tables])  # 0.1 V
        self._heat = np.full(count, AMBIENT)
        self._slow_at = -np.inf

    def refresh(self, now: float, direction: Floats, shift: Floats, reference: Floats) -> None:
        """Bring every present register up to `now`. `direction`, `shift`: encoder to register frame."""
        muscles = self._muscles
        encoder = np.rint(muscles.position)
        self.position.put(encoder * direction + shift)
        velocity = np.rint(muscles.velocity)
        self._velocity.put(velocity)
        self._moving.put(np.abs(velocity) > self._threshold.get())
        self._moving_status.put(np.abs(reference - encoder) < IN_POSITION)
        for effort in self._efforts:
            effort.put(np.rint(muscles.current))
        self._pwm.put(np.rint(muscles.pwm))
        self._trajectory.put(np.rint(reference) * direction + shift)
        self._tick.put(
            ((now - self.origin) * 1e3).astype(np.int64) & 0x7FFF
        )  # 15 bits: facts of register 120
        if now - self._slow_at >= 0.1:
            self._slow(now)

    def _slow(self, now: float) -> None:
        """Supply and temperature, ten times a second: they change slowly."""
        ampere = np.abs(self._muscles.current) * AMPERE
        dt = min(now - self._slow_at, 10.0 * WARM_TIME)
        self._slow_at = now
        rest = AMBIENT + WARMTH * ampere**2
        self._heat = rest + (self._heat - rest) * np.exp(-dt / WARM_TIME)
        self._temperature.put(np.rint(self._heat))
        self._voltage.put(np.rint(self.supply - 10.0 * SAG * ampere.sum()))
