"""A robot whose body in MuJoCo, the one of virtual servos, has hidden parameters: real bytes, gate and loop.

Goals and positions are rounded to counts, the drive saturates as that of a servo, joints meet their stops,
and a cable pulls each joint like a spring: effects that no identified model has.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from tests.support.daemon_rig import Rig
from tests.support.hidden_robot import HiddenRobot
from tests.support.true_servos import true_servos
from twind import link
from twind.config.identified_spec import IdentifiedJoint, IdentifiedModel, ParameterEstimate
from twind.gap.gap_replay import resample
from twind.gap.motion_samples import MotionSamples
from twind.identification.excitation import ExcitationBounds
from twind.identification.live_excitation import SMALLER, TOGETHER, motion_of
from twind.robot.trajectory import Trajectory
from twind.virtual.virtual_robot_spec import body_for, buses

RENEWED = 20  # ticks from one renewal of the lease to the next
QUIET = 0.5  # s in which no joint reads a velocity: the robot rests
LONGEST = 20.0  # s until it must rest
READY = 2.0  # s on the way to the pose in which joints move


class HiddenBodyRig(Rig):
    """A daemon that knows the plain robot, on servos that the hidden robot's body moves."""

    def __init__(self, hidden: HiddenRobot) -> None:
        self._hidden = hidden
        super().__init__(hidden.binding.robot.name)

    def _virtual(self, bus: str, start: Any) -> Any:
        made = self.__dict__.setdefault("_made_buses", {})
        if not made:
            true = replace(self.made, robot=self._hidden.hidden.robot)
            self.body = body_for(true, now=self.clock.now())
            for joint, pull in zip(true.robot.joints, self._hidden.cable, strict=True):
                self.body.model.jnt_stiffness[self.body.model.joint(joint.model_joint).id] = pull
            made.update(buses(true, physics=False, body=self.body, now=self.clock.now()))
        return made[bus]

    def excite(self, pose: str, amplitude: float) -> MotionSamples:
        """Move each joint alone, then all together, as `live_excitation` does; return the motion."""
        self.connect()
        self.hang_quiet()
        self.arm()
        self._rows: list[tuple[float, Any, Any, Any]] = []
        self._follow(
            np.array([list(self.robot.poses[pose].values())]), np.array([READY]), range(len(self.names))
        )
        for name in self.names:
            self._try([name], amplitude)
        self._try(list(self.names), TOGETHER * amplitude)
        time, goal, position, velocity = (np.array(column) for column in zip(*self._rows, strict=True))
        unknown = np.full_like(goal, np.nan)
        return resample(
            MotionSamples(self.names, time, goal, position, velocity, unknown), self.loop.robot.period
        )

    def hang_quiet(self) -> None:
        """Wait until the limp robot rests: a cable stronger than its friction moves it out of its rest pose.

        Arming is refused (ARM_FAILED) while joints move.
        """
        period = self.loop.robot.period
        quiet = 0
        for _ in range(round(LONGEST / period)):
            self.ticks(1)
            quiet = quiet + 1 if (self.loop.robot.measured.velocity == 0.0).all() else 0
            if quiet * period >= QUIET:
                return
        raise AssertionError("the limp robot does not come to rest")

    def true_parameters(self) -> IdentifiedModel:
        """Return what the body of the armed robot has; it knows no dead band, sag or friction near rest."""
        columns = true_servos(self.body.model, self.robot)
        columns |= dict.fromkeys(
            ("stribeck_nm", "dead_band_rad", "backlash_rad", "sag_per_nm"), np.zeros(len(self.names))
        )
        joints = {}
        for at, name in enumerate(self.names):
            found = {key: ParameterEstimate(float(each[at]), 0.0, 0.0, 0.0) for key, each in columns.items()}
            joints[name] = IdentifiedJoint(**found)
        return replace(self._hidden.truth, joints=joints)

    def _try(self, names: list[str], amplitude: float) -> None:
        limits = self.one.binding.limits
        places = [self.names.index(name) for name in names]
        bounds = {
            name: ExcitationBounds(
                limits.lower[at], limits.upper[at], limits.velocity[at], limits.acceleration[at]
            )
            for name, at in zip(names, places, strict=True)
        }
        here = self.loop.executor.reference.position
        start = {name: float(here[at]) for name, at in zip(names, places, strict=True)}
        for share in SMALLER:
            points, times = motion_of(bounds, start, share * amplitude)
            if self._follow(points, times, places):
                return

    def _follow(self, points: Any, times: Any, places: Any) -> bool:
        """Submit a motion and record it; False: refused."""
        rows = np.tile(self.loop.executor.reference.position, (len(times), 1))
        rows[:, list(places)] = points
        commanded = np.isin(np.arange(len(self.names)), list(places))
        self.lease()
        ticket = self.submit(Trajectory(times, rows, commanded, None), more=True, policy="retime")
        most = round(2.0 * times[-1] / self.loop.robot.period) + 200
        for tick in range(most):
            if tick % RENEWED == 0:
                self.send(link.AcquireLease)
            self.ticks(1)
            now = self.loop.robot.measured
            reference = self.loop.executor.reference
            self._rows.append((now.time, reference.position.copy(), now.position.copy(), now.velocity.copy()))
            done = [reply for reply in self.replies(ticket) if not reply.continues]
            if done:
                return done[-1].error is None
        raise AssertionError("the motion did not end")
