"""Arms whose servos report no current feel a hand too: torque by the model of their servos. Virtual time."""

from collections.abc import Iterator

import numpy as np
import pytest

from tests.support.contact_rig import ContactRig
from twind import link
from twind.robot.arrays import Floats
from twind.robot.trajectory import Trajectory

STRETCHED = {"shoulder_lift": 0.0, "elbow_flex": -0.2}
SECONDS = 9.0  # of a dance


class ArmRig(ContactRig):
    """The daemon knows the stiffness of the servos, within five percent."""

    hold_nm = np.inf
    knows_stiffness = True

    def pose(self) -> Floats:
        """Return the pose around which it moves (n,), rad."""
        return np.array([STRETCHED.get(name, 0.0) for name in self.names])


@pytest.fixture(params=["so101", "koch"])
def rig(request: pytest.FixtureRequest) -> Iterator[ArmRig]:
    """An arm at its pose. so101 measures no current, koch of four servos of six."""
    made = ArmRig(request.param)
    made.arm()
    made.lease()
    pose = made.pose()[None]
    everyone = np.ones(len(made.names), np.bool_)
    made.submit(Trajectory(np.array([3.0]), pose, everyone, np.zeros_like(pose)), more=True)
    made.seconds(4.0)  # away from its stops, which count as contact
    made.news.clear()
    yield made
    made.close()


@pytest.mark.parametrize("dances", [1, pytest.param(400, marks=pytest.mark.campaign)])
def test_motions_are_no_contact(rig: ArmRig, dances: int) -> None:
    for seed in range(dances):
        rig.lease()
        ticket = rig.dance(SECONDS - 1.0, seed, rig.pose())
        rig.seconds(SECONDS)
        assert rig.replies(ticket)[-1].parameters["phase"] == "succeeded", rig.replies(ticket)[-1]
        assert rig.loop.robot.observer is not None and rig.loop.robot.observer.external is not None
        assert not rig.events("CONTACT"), (seed, rig.events("CONTACT"))
        rig.news.clear()


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("joint", ["shoulder_lift", "elbow_flex", "wrist_flex"])
def test_a_press_is_found_with_its_torque_and_ends(rig: ArmRig, joint: str, sign: float) -> None:
    observer = rig.loop.robot.observer
    contact = rig.loop.parts.guard.contact
    place = rig.names.index(joint)
    rig.press(joint, sign * 0.3)
    rig.seconds(0.5)
    assert contact.touched[place] and rig.events("CONTACT")
    assert observer is not None and observer.external is not None
    assert observer.external.torque[place] == pytest.approx(sign * 0.3, abs=0.1)
    rig.press(joint, 0.0)
    rig.seconds(1.0)
    assert not contact.touched[place]


def test_a_limp_arm_without_current_has_no_estimate(rig: ArmRig) -> None:
    assert rig.call(link.Disarm, ticks=800).error is None
    rig.seconds(0.1)
    assert rig.loop.robot.observer is not None and rig.loop.robot.observer.external is None
