"""Torque of this daemon: its only owner. Pure: no device, no clock; a transition is named after its cause.

What the servos report is read elsewhere (`torque_readback`). Here is what this daemon has ordered, and what
of it is not confirmed. No other module assigns a field (`tests/loop/test_torque_state.py`).
"""

import numpy as np

from twind.robot.arrays import Bools


class TorqueState:
    """State of torque, joint by joint where a joint may differ from the others."""

    def __init__(self, count: int) -> None:
        """`count`: number of joints. No torque, and nothing latched."""
        self._held: Bools
        self._armed: bool
        self._set_held(np.zeros(count, np.bool_))
        self._limp: Bools
        self._partial: bool
        self._set_limp(np.zeros(count, np.bool_))
        self._energising = False
        self._inhibited = False
        self._unconfirmed = False
        self._pending_restore = False
        self._soft_since: float | None = None
        self._stop_level: str | None = None
        self._stop_begun = False

    # ------------------------------------------------------------------------------- what is so

    @property
    def held(self) -> Bools:
        """Joints (n,) that this daemon holds with torque, on buses that were not lost since. Read-only."""
        return self._held

    @property
    def armed(self) -> bool:
        """True while this daemon holds any joint."""
        return self._armed

    @property
    def limp(self) -> Bools:
        """Joints (n,) that stay without torque by request while the others hold. Read-only."""
        return self._limp

    @property
    def partial(self) -> bool:
        """True while a joint stays limp by request."""
        return self._partial

    @property
    def energising(self) -> bool:
        """Torque was switched on or off, and is not read back yet."""
        return self._energising

    @property
    def inhibited(self) -> bool:
        """Nothing may be written until an operator resets; torque stays as it is."""
        return self._inhibited

    @property
    def unconfirmed(self) -> bool:
        """Torque off was sent, and a device has not confirmed it."""
        return self._unconfirmed

    @property
    def pending_restore(self) -> bool:
        """A bus with torque of this daemon was lost, and torque is not read off everywhere since."""
        return self._pending_restore

    @property
    def soft_since(self) -> float | None:
        """Time of the demand for damping, s; None: there is none. It stays until torque is off."""
        return self._soft_since

    @property
    def stop_level(self) -> str | None:
        """Level of the latched e-stop, `settle` or `cut`; None: none is latched."""
        return self._stop_level

    @property
    def stop_begun(self) -> bool:
        """The first effect of the e-stop under way was read back from the devices."""
        return self._stop_begun

    # ------------------------------------------------------------------------------- on and off

    def leave_limp(self, joints: Bools) -> None:
        """Keep `joints` (n,) without torque until torque goes off: the others are about to be held."""
        self._set_limp(joints)

    def begin_energising(self) -> None:
        """Torque is about to be switched on: from here on every end switches it off again."""
        self._energising = True

    def take_hold(self, joints: Bools) -> None:
        """Hold `joints` (n,) at goals that the devices have confirmed. A lost bus is still to come back."""
        self._set_held(joints)
        self._energising = False
        self._unconfirmed = False
        if (joints | self._limp).all():
            self._pending_restore = False

    def begin_release(self) -> None:
        """Torque off is sent to every joint. It counts as on until it is read back."""
        self._set_held(np.zeros_like(self._held))
        self._set_limp(np.zeros_like(self._limp))
        self._energising = True
        self._unconfirmed = True
        self._soft_since = None

    def defer_release(self) -> None:
        """Note that torque off reaches no bus now: it is due where one was lost with torque."""
        self._unconfirmed = self._unconfirmed or self._pending_restore

    def confirm_off(self) -> None:
        """Every device that replies has confirmed torque off; a bus that is lost is still to confirm it."""
        self._energising = False
        self._unconfirmed = self._pending_restore

    def leave_unconfirmed(self) -> None:
        """Stop waiting for devices that do not confirm torque off: it is sent again when they reply."""
        self._energising = False

    def abandon_switching(self) -> None:
        """Note that switching ends where it is: torque that may have come on is to be switched off."""
        if self._energising:
            self._unconfirmed = True

    def find_off(self) -> None:
        """Torque was read back off everywhere: nothing is left to switch off."""
        if self._partial:  # called in every tick without torque
            self._set_limp(np.zeros_like(self._limp))
        self._unconfirmed = False
        self._pending_restore = False

    # ------------------------------------------------------------------------------- buses

    def lose_bus(self, joints: Bools) -> None:
        """A bus with torque of this daemon was lost: its `joints` (n,) are held no more, the others are."""
        self._set_held(self._held & ~joints)
        self._pending_restore = True

    def regain_bus(self, joints: Bools) -> None:
        """Hold `joints` (n,) too: their bus is back, and the devices have confirmed their goals."""
        self._set_held(self._held | joints)

    def lose_every_bus(self) -> None:
        """No bus is left to write to. Devices that come back are stiff again, and are lowered as any."""
        self._set_held(np.zeros_like(self._held))
        self._set_limp(np.zeros_like(self._limp))
        self._energising = False
        self._soft_since = None

    # ------------------------------------------------------------------------------- damping

    def demand_damping(self, now: float) -> bool:
        """Allow only damping and torque off from `now` (s) on; False: it was demanded already."""
        if self._soft_since is not None:
            return False
        self._soft_since = now
        return True

    def end_damping(self) -> None:
        """No procedure damps any more, and torque stays."""
        self._soft_since = None

    # ------------------------------------------------------------------------------- latches

    def inhibit(self) -> None:
        """Forbid every write until a reset."""
        self._inhibited = True

    def lift_inhibit(self) -> None:
        """An operator has acknowledged every latched code."""
        self._inhibited = False

    def latch_stop(self, level: str) -> None:
        """Latch an e-stop of that level. A cut is never replaced by a milder level."""
        if self._stop_level != "cut":
            self._stop_level = level

    def begin_stop(self) -> None:
        """A procedure begins the e-stop: nothing of it is confirmed yet."""
        self._stop_begun = False

    def confirm_stop_begun(self) -> None:
        """The devices have confirmed the first effect of the e-stop."""
        self._stop_begun = True

    def lift_stop(self) -> None:
        """An operator has acknowledged the e-stop."""
        self._stop_level = None

    def _set_limp(self, joints: Bools) -> None:
        self._limp = joints.copy()
        self._limp.setflags(write=False)
        self._partial = bool(joints.any())

    def _set_held(self, joints: Bools) -> None:
        self._held = joints.copy()
        self._held.setflags(write=False)
        self._armed = bool(joints.any())
