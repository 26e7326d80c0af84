"""A robot whose stops are known, being calibrated: a whole loop, real bytes, hard stops."""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from tests.support.daemon_rig import Rig
from twind import link
from twind.config.counts import ticks_of
from twind.virtual.robot_ground_truth import JointGroundTruth, RobotGroundTruth
from twind_drivers.dynamixel.control_tables import table

JOINT = "head_yaw"
OTHER = 9  # a client that holds nothing
RAD = 4096 / (2.0 * math.pi)  # counts
SETTINGS = (
    "operating_mode",
    "drive_mode",
    "homing_offset",
    "min_position_limit",
    "max_position_limit",
    "current_limit",
    "pwm_limit",
    "goal_current",
    "goal_pwm",
    "profile_velocity",
    "profile_acceleration",
    "position_p_gain",
    "position_i_gain",
    "position_d_gain",
    "velocity_p_gain",
    "velocity_i_gain",
    "feedforward_1st_gain",
    "feedforward_2nd_gain",
    "led",
    "status_return_level",
)


class Homed(Rig):
    """`JOINT` and its servo; calls that a client of a calibration makes."""

    def __init__(self, joint: str = JOINT, *, truth: Mapping[str, Any] | None = None, **how: Any) -> None:
        how.setdefault("start", {JOINT: -1.3})
        super().__init__(truth=RobotGroundTruth({joint: JointGroundTruth(**(truth or {}))}), **how)
        self.place = self.names.index(joint)
        self.spec = self.robot.joints[self.place]
        self.bus = self.virtual[self.spec.bus]
        self.row = [each.name for each in self.made.joints(self.spec.bus)].index(joint)
        self.before: dict[str, int] = {}

    def ready(self, *, odd: bool = True) -> None:
        """Connected, leased, calibrating; with `odd` settings that nobody here would have chosen."""
        self.connect()
        if odd:
            for name, value in (("profile_velocity", 33), ("position_p_gain", 777), ("led", 1)):
                self.put(name, value)
        self.lease()
        assert self.call(link.Calibrate, on=True).error is None
        self.before = self.settings()

    def find(self, side: str = "lower", *, more: bool = False, **how: Any) -> int:
        """Begin; the ticket."""
        return self.send(link.FindStop, joint=self.place, side=side, more=more, **how)

    def last(self, ticket: int, seconds: float = 90.0) -> link.Reply:
        """Its last answer."""
        for _ in range(round(seconds / self.loop.robot.period)):
            self.ticks(1)
            done = [reply for reply in self.replies(ticket) if not reply.continues]
            if done:
                return done[-1]
        raise AssertionError(
            f"no answer within {seconds} s: {[event.message for event in self.events()][-5:]}"
        )

    def powered(self, ticket: int) -> None:
        """Until its servo has torque and moves."""
        for _ in range(500):
            self.ticks(1)
            assert not [reply for reply in self.replies(ticket) if not reply.continues], self.replies(ticket)
            if self.get("torque_enable") and self.loop.commands.homing.unrestored.powered is not None:
                self.ticks(20)
                return
        raise AssertionError("never powered")

    # ------------------------------------------------------------------------- past the bus

    def get(self, name: str) -> int:
        """A register of its servo, without asking it."""
        return int(self.bus.servos.memory.value(self.row, table(1020)[name]))

    def put(self, name: str, value: int) -> None:
        """The same, set past all rules."""
        self.bus.servos.memory.store(self.row, table(1020)[name], value)
        self.bus.servos.invalidate_cache()

    def settings(self) -> dict[str, int]:
        """All that must be as it was."""
        return {name: self.get(name) for name in SETTINGS}

    def torques(self) -> list[int]:
        """Torque enable of every servo of its bus."""
        return self.bus.servos["torque_enable"].tolist()

    def stop(self, side: str = "lower") -> int:
        """True place of its stop, in reported counts."""
        angle = self.spec.stops.endstop_of_side(side)
        assert angle is not None
        return ticks_of(self.spec, self.made.shown[self.spec.name], angle)

    def undone(self, seconds: float = 4.0) -> None:
        """Torque is off and everything is as it was, of an independent look."""
        for _ in range(round(seconds / self.loop.robot.period)):
            if self.loop.commands.homing.unrestored is None:
                break
            self.ticks(1)
        assert not any(self.torques())
        assert self.settings() == self.before
        assert self.get("bus_watchdog") == 0


@contextmanager
def homed(**how: Any) -> Iterator[Homed]:
    made = Homed(**how)
    try:
        yield made
    finally:
        made.close()


def codes(reply: link.Reply) -> list[str]:
    return [finding["code"] for finding in reply.parameters.get("findings") or ()]


def failed(made: Homed, ticket: int) -> list[str]:
    """It ended badly, is told so, and everything is undone; the codes."""
    reply = made.last(ticket)
    assert reply.error is None and reply.parameters["phase"] == "failed", reply
    assert reply.parameters.get("ticks") is None
    made.undone()
    return codes(reply)


def energise(made: Homed, row: int) -> None:
    """Its torque comes on, by nobody we know."""
    made.bus.servos.torque(row, True)
    made.bus.servos.invalidate_cache()
