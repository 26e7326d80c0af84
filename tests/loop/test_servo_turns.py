"""Whatever turn a servo starts on, wherever its seam and its offset are: the joint's angle is its angle."""

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import Phase, given
from hypothesis import strategies as st

from tests.support.daemon_rig import Rig
from tests.support.examples import examples
from tests.support.planar_arm import arm_in
from twind import link
from twind.exceptions import InvalidInput
from twind.virtual.robot_ground_truth import JointGroundTruth, RobotGroundTruth

SIGNS = {"single": 1, "extended": -1, "capped": 1}
NAMES = tuple(SIGNS)
NEAR = 0.012  # rad: what following leaves, and a count


@pytest.fixture(scope="module")
def arm() -> Iterator[str]:
    with TemporaryDirectory() as folder:
        yield arm_in(Path(folder))


class Watched(Rig):
    """Each tick of a robot that is identified: measured is where the servos are, and makes no step."""

    last: np.ndarray | None = None

    def ticks(self, count: int) -> None:
        for _ in range(count):
            super().ticks(1)
            loop = self.loop
            settled = loop.hardware.connected and loop.identity.verified.joints.all()
            if loop.torque.armed or settled:
                assert np.abs(loop.robot.measured.position - self.truth).max() < 0.1, self.truth
                if self.last is not None:
                    assert np.abs(loop.robot.measured.position - self.last).max() < 0.1
            self.last = loop.robot.measured.position.copy() if loop.torque.armed or settled else None


@st.composite
def truths(draw: st.DrawFn) -> RobotGroundTruth:
    """Seams anywhere, turns either way, offsets that position mode takes."""
    found = {}
    for name in NAMES:
        most = 1024 if name == "single" else 6000
        reverse = draw(st.booleans())
        found[name] = JointGroundTruth(
            zero_ticks=draw(st.one_of(st.integers(0, 4095), st.integers(-300, 300))),
            turns=draw(st.sampled_from([0, 0, 0, 0, 1, -2]) if name == "single" else st.integers(-3, 3)),
            homing_offset=draw(st.one_of(st.just(0), st.integers(-most, most))),
            drive_mode=int(reverse),
            sign=-SIGNS[name] if reverse else SIGNS[name],  # of the bare encoder
        )
    return RobotGroundTruth(found)


STARTS = st.fixed_dictionaries({name: st.floats(-0.7, 0.7) for name in NAMES})


@pytest.mark.slow
@examples(40, phases=[Phase.generate])
@given(truths(), STARTS, st.floats(-0.6, 0.6))
def test_every_start_gives_a_continuous_angle_or_is_refused_by_name(
    arm: str, truth: RobotGroundTruth, start: dict[str, float], goal: float
) -> None:
    try:
        rig = Watched(arm, truth=truth, start=start)
    except InvalidInput:  # of the turn that position mode has nothing is in its travel
        return
    try:
        rig.connect()
        rig.lease()
        reply = rig.call(link.Arm)
        limits = rig.loop.robot.limits
        place = np.array([start[name] for name in NAMES])
        reachable = bool(((place > limits.hard_lower + 0.01) & (place < limits.hard_upper - 0.01)).all())
        if reply.error is not None:
            assert (
                not reachable or truth.joint_truth("single").turns
            )  # position mode wakes up on its one turn
            codes = {each["code"] for each in reply.parameters["findings"]}
            assert codes <= {"OUT_OF_LIMIT", "CALIB_MISMATCH"}
            assert not rig.register("torque_enable").any()
            return
        assert not truth.joint_truth("single").turns
        assert np.abs(rig.truth - place).max() < NEAR
        to = float(np.clip(goal, limits.lower[0] + 0.05, limits.upper[0] - 0.05))  # and room to brake
        rig.submit(rig.path("single", [to], [3.0]), more=True)
        rig.seconds(3.5)
        place[0] = to
        assert np.abs(rig.truth - place).max() < NEAR
        assert rig.loop.condition.latches == {}
    finally:
        rig.close()
