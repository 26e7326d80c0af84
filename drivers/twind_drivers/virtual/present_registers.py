"""Present registers of a servo, filled from its physics."""

import numpy as np
from numpy.typing import NDArray

from twind_drivers.virtual.mode_units import FULL_PWM
from twind_drivers.virtual.register_memory import RegisterMemory
from twind_drivers.virtual.servo_physics import ServoPhysics
from twind_drivers.virtual.servo_profile import ServoProfile
from twind_drivers.virtual.servo_protection import ServoProtection

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
FIRST = "realtime_tick"
LAST = "present_temperature"
IN_POSITION = 20.0  # ticks from the goal (assumed: the manual gives no number)
FOLLOWING = 100.0  # ticks from the trajectory that are a following error (assumed)
# bits of the moving status (123); 0x30: type of the profile
ARRIVED = 0x01
ONGOING = 0x02
ERRING = 0x08


class PresentRegisters:
    """Columns of the registers that only the servo itself writes. One refresh serves all servos."""

    def __init__(self, memory: RegisterMemory, muscles: ServoPhysics, protection: ServoProtection) -> None:
        self._muscles = muscles
        self._protection = protection
        self._tick = memory.column("realtime_tick", 2)
        self._moving = memory.column("moving", 1)
        self._moving_status = memory.column("moving_status", 1)
        self._pwm = memory.column("present_pwm", 2, signed=True)
        has = {key: any(key in each for each in memory.tables) for key in ("present_current", "present_load")}
        self._current = memory.column("present_current", 2, signed=True) if has["present_current"] else None
        self._load = memory.column("present_load", 2, signed=True) if has["present_load"] else None
        self._velocity = memory.column("present_velocity", 4, signed=True)
        self.position = memory.column("present_position", 4, signed=True)
        self._speed_wanted = memory.column("velocity_trajectory", 4, signed=True)
        self._place_wanted = memory.column("position_trajectory", 4, signed=True)
        self._voltage = memory.column("present_input_voltage", 2)
        self._temperature = memory.column("present_temperature", 1)
        self._volts = np.array([each.facts.volts_per_count for each in memory.tables])
        self._threshold = memory.column("moving_threshold", 4)
        count = len(memory.raw)
        self.origin = np.zeros(count)  # s, when each servo was powered on
        self._way: Floats | None = None
        self._seeks: Bools | None = None
        self._frozen: Bools | None = None
        self._stuck = np.zeros(count)  # ticks, what a frozen encoder repeats
        # of the last refresh
        self._encoder = np.zeros(count)
        self._at = 0.0
        self._reported = True
        self._slow_at = -np.inf
        self._spikes: dict[int, tuple[float, float]] = {}  # row -> °C shown, until when
        self._shaped = True  # may the velocity trajectory be other than 0?

    def follow(self, way: Floats, seeks: Bools) -> None:
        """Set the direction (m,) of velocity, current and PWM, and the servos with position goals."""
        self._way = None if (way > 0).all() else way.copy()
        self._seeks = None if seeks.all() else seeks.copy()

    def freeze(self, row: int, on: bool) -> None:
        """The register of the position repeats what it shows (the loop inside keeps its own sight of it)."""
        frozen = np.zeros(len(self._stuck), np.bool_) if self._frozen is None else self._frozen
        frozen[row] = on
        self._stuck[row] = np.rint(self._muscles.position[row])
        self._frozen = frozen if frozen.any() else None

    def wake(self, row: int, now: float) -> None:
        """A servo has booted: its clock begins, and all that it measures is shown with the next refresh."""
        self.origin[row] = now
        self._slow_at = -np.inf

    def spike(self, row: int, celsius: float, until: float) -> None:
        """The register of the temperature shows `celsius` until then (s)."""
        self._spikes[row] = (celsius, until)
        self._slow_at = -np.inf

    def refresh(self, now: float, direction: Floats, shift: Floats) -> None:
        """Bring position, velocity and current up to `now`. `direction`, `shift`: of encoder to register."""
        muscles = self._muscles
        way = self._way
        encoder = np.rint(muscles.position)
        if self._frozen is not None:
            encoder = np.where(self._frozen, self._stuck, encoder)
        self.position.put(encoder * direction + shift)
        self._velocity.put(np.rint(muscles.velocity if way is None else muscles.velocity * way))
        if self._current is not None:
            self._current.put(np.rint(muscles.current if way is None else muscles.current * way))
        self._encoder = encoder
        self._at = now
        self._reported = False

    def refresh_slow_values(self, direction: Floats, shift: Floats, profile: ServoProfile) -> None:
        """All that is read more rarely, as of the last refresh."""
        if self._reported:
            return
        self._reported = True
        now = self._at
        muscles = self._muscles
        way = self._way
        encoder = self._encoder
        moving = np.abs(np.rint(muscles.velocity)) > self._threshold.get()
        if profile.shaped or self._seeks is not None:
            self._show_profile(profile, encoder, encoder * direction + shift, direction, shift)
            moving |= profile.running
        else:
            self._show_step(profile.reference, encoder, direction, shift)
        self._moving.put(moving)
        pwm = np.rint(muscles.pwm if way is None else muscles.pwm * way)
        self._pwm.put(pwm)
        if self._load is not None:  # e-manual XL430, "Present Load": of the output, not of a sensor; 0.1 %
            self._load.put(np.rint(pwm * (1000.0 / FULL_PWM)))
        # 15 bits: e-manual, "Realtime Tick (120)"
        self._tick.put(((now - self.origin) * 1e3).astype(np.int64) & 0x7FFF)
        if now - self._slow_at >= 0.1:
            self._slow_at = now
            self._temperature.put(np.clip(np.rint(self._protection.celsius), 0, 255))
            for row, (celsius, until) in list(self._spikes.items()):
                if now >= until:
                    del self._spikes[row]
                else:
                    self._temperature.put(round(celsius), row)
            self._voltage.put(np.rint(np.maximum(self._protection.volts, 0.0) / self._volts))

    def _show_step(self, goal: Floats, encoder: Floats, direction: Floats, shift: Floats) -> None:
        """Fill the registers if all goals are positions without profile: the goal is the trajectory."""
        gap = np.abs(goal - encoder)
        near = gap < IN_POSITION
        if np.count_nonzero(near) == len(near):
            self._moving_status.put(ARRIVED)
        else:
            self._moving_status.put(near * ARRIVED + (gap > FOLLOWING) * ERRING)
        self._place_wanted.put(np.rint(goal) * direction + shift)
        if self._shaped:
            self._speed_wanted.put(0)
            self._shaped = False

    def _show_profile(
        self, profile: ServoProfile, encoder: Floats, place: Floats, direction: Floats, shift: Floats
    ) -> None:
        """e-manual, "Moving Status": in position and following error only where a position is sought."""
        self._shaped = True
        seeks = np.ones(len(encoder), np.bool_) if self._seeks is None else self._seeks
        way = 1.0 if self._way is None else self._way
        arrived = seeks & (np.abs(profile.target - encoder) < IN_POSITION)
        erring = seeks & (np.abs(profile.reference - encoder) > FOLLOWING)
        bits = arrived * ARRIVED + profile.running * ONGOING + erring * ERRING
        self._moving_status.put(bits + profile.kind)
        self._place_wanted.put(np.where(seeks, np.rint(profile.reference) * direction + shift, place))
        wanted = np.where(seeks, profile.speed / profile.raw, np.where(profile.spins, profile.reference, 0.0))
        self._speed_wanted.put(np.rint(wanted * way))
