"""A robot whose servos have no watchdog under the fake clock: without a master they hold their last goal."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.proof.faults.fault import Fault
from tests.proof.faults.world import World
from tests.support.daemon_rig import Rig
from twind import link
from twind.robot.modes import Motion, RobotState
from twind.robot.trajectory import Trajectory

ARM = "so101"
# Two poses, rad, clear of body and desk with any joints of either.
FOLDED = {"shoulder_lift": -1.3, "elbow_flex": 1.0, "wrist_flex": 0.3}
CLEAR = {
    "shoulder_pan": 0.5,
    "shoulder_lift": -0.9,
    "elbow_flex": 0.6,
    "wrist_flex": 0.0,
    "wrist_roll": 0.6,
    "gripper": 0.4,
}
LOOKS = (
    4  # of the servos, the present one and those of three ticks: the oldest that a fresh reading may be of
)
ROUNDED = 3  # counts: of the register, of the position that is worked out here


class HoldingRig(Rig):
    """Registers and shafts of servos that are asked for them by name; none has a watchdog."""

    def register(self, key: str) -> np.ndarray:
        """(m,) a register; a watchdog is 0."""
        (servos,) = (bus.servos for bus in self.virtual.values())
        if key == "bus_watchdog":
            return np.zeros(len(servos.ids()), np.int64)
        return np.array([servos.get(row, key) for row in range(len(servos.ids()))])


class TruthJudge:
    """Judges each reading that is fresh: it lies where the shaft was within the last three ticks."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.wrong: list[str] = []
        self.judged = 0
        self._seen: deque[NDArray[np.float64]] = deque(maxlen=LOOKS)
        self._rounded = np.array(
            [ROUNDED * 2.0 * np.pi / joint.type.ticks_per_turn / joint.ratio for joint in rig.robot.joints]
        )

    def look(self) -> None:
        """Note the shafts, judge the readings."""
        self._seen.append(self.rig.truth)
        measured = self.rig.loop.robot.measured
        if len(self._seen) < LOOKS:
            return
        seen = np.array(self._seen)
        wrong = (measured.position < seen.min(axis=0) - self._rounded) | (
            measured.position > seen.max(axis=0) + self._rounded
        )
        self.judged += int(measured.heard.sum())
        for joint in np.flatnonzero(wrong & measured.heard).tolist():
            now = self.rig.clock.now()
            place = f"{measured.position[joint]:.4f} rad, it is at {seen[-1, joint]:.4f}"
            self.wrong.append(f"{now:.3f} {self.rig.names[joint]}: reads {place}")


class HoldingWorld(World):
    """`joint` is a random one, `id` its servo."""

    robot = ARM
    clear: Mapping[str, float] = CLEAR
    around: Mapping[str, float] = FOLDED

    def __init__(self, fault: Fault, seed: int) -> None:
        super().__init__(fault, seed)
        self.free = False  # it is clamped to a desk

    def live(self, robot: str = ARM, *, judge: bool = False, **how: Any) -> Rig:
        """A daemon in live mode, everybody identified; each fresh reading is judged."""
        rig = self.take(HoldingRig(self.robot, **how))
        self.judge = TruthJudge(rig)  # type: ignore[assignment]
        for _ in range(300):
            self.ticks(1)
            if rig.loop.condition.state is RobotState.CONNECTED:
                return rig
        raise AssertionError("never connected")

    def arm(self) -> None:
        """The same, out of the rest pose, where some joints lie on their stops."""
        super().arm()
        way = np.array([[self.around.get(name, 0.0) for name in self.rig.names]])
        ticket = self.rig.submit(
            Trajectory(np.array([1.5]), way, np.ones(way.shape[1], np.bool_)), policy="retime"
        )
        for _ in range(4):
            self.seconds(0.5)
            self.call(link.AcquireLease)
        assert self.rig.loop.executor.motion is Motion.HOLDING, self.rig.replies(ticket)

    def moving(self, robot: str = ARM, *, far: float = 0.0, **how: Any) -> Rig:
        """The same, armed and on its way."""
        return super().moving(self.robot, far=far, **how)

    def note(self) -> None:
        """Record the present, and judge the readings."""
        super().note()
        if isinstance(self.judge, TruthJudge):
            self.judge.look()

    # ------------------------------------------------------------------------------------ what must be seen

    def stops_where_it_was_sent(self, since: float, but: tuple[int, ...] = ()) -> None:
        """Nobody speaks to the servos: they end at their last goals, and keep torque."""
        rows = self.rows(but)
        self.seconds(max(0.0, since + 0.5 - self.now))
        self.claim(bool((self.rig.register("torque_enable")[rows] == 1).all()), "torque went off by itself")
        off = np.abs(self.rig.counts - self._zero_shift() - self.rig.register("goal_position"))[rows]
        self.claim(bool((off <= 30).all()), f"a servo stands {off.max():.0f} counts from its last goal")

    def _zero_shift(self) -> NDArray[np.float64]:
        """(m,) encoder counts at which the position register shows 0."""
        (bus,) = self.rig.virtual.values()
        return np.array([bus.servos.encoder(row, 0.0) for row in range(len(bus.ids()))])

    def recover(self) -> None:
        """Torque off, acknowledged, armed, moving: by commands alone."""
        rig = self.rig
        try:
            self._down()
            self.seconds(1.1)
            connected = self.until(lambda: rig.loop.condition.state is RobotState.CONNECTED, 5.0)
            assert connected, f"state {rig.loop.condition.state.value} after a reset"
            self.arm()
            self.joint = int(
                self.random.choice([at for at, name in enumerate(rig.names) if self._stroke(name) > 0.1])
            )
            self.move()
            since = self.now
            self.seconds(1.5)
            moved = np.ptp(self.trace.place(since)[:, self.row(self.joint)])
            assert moved > 20, f"armed again, and {rig.names[self.joint]} moves {moved:.0f} counts"
        except AssertionError as error:
            self.blame(f"no way back: {error}")


# Of a humanoid with twenty MX-28: arms apart, knees bent, feet side by side.
BENT = {
    **{"l_shoulder_roll": 0.6, "r_shoulder_roll": -0.6, "l_elbow": -0.3, "r_elbow": -0.3},
    **{
        f"{side}_{joint}": value
        for side in "lr"
        for joint, value in (("hip_pitch", -0.3), ("knee", 0.6), ("ankle_pitch", -0.3))
    },
}
MOVED = {name: value + 0.25 * (1 if value <= 0.0 else -1) for name, value in BENT.items()}
MOVED |= {"head_pan": 0.6, "head_tilt": -0.3, "l_shoulder_pitch": 0.4, "r_shoulder_pitch": -0.4}


class ProtocolOneWorld(HoldingWorld):
    """Servos of Dynamixel Protocol 1.0, read together by bulk read."""

    robot = "docs/examples/darwin/darwin.yaml"
    clear = MOVED
    around = BENT
