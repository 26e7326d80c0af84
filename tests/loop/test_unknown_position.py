"""A joint of which nobody knows where it is: its position is null, and no goal goes there. Real bytes."""

from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

from tests.support.daemon_rig import MakeRig, Rig
from tests.support.planar_arm import arm_in
from twind import link
from twind.loop.bus.joint_readings import JointReadings
from twind.loop.procedures.lowering import SettleProfile
from twind.loop.procedures.torque_readback import torque_inherited
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode
from twind.virtual.robot_ground_truth import JointGroundTruth, RobotGroundTruth
from twind_drivers.bus import BusError
from twind_drivers.dynamixel.control_tables import table

SINGLE, EXTENDED, CAPPED = range(3)
OUT = {"single": 0.3, "extended": 0.02, "capped": 0.3}  # away from the rest pose
STOPS = [link.Disarm, link.EStop]


@pytest.fixture(scope="module")
def path() -> Iterator[str]:
    with TemporaryDirectory() as folder:
        yield arm_in(Path(folder))


def inherited(make_rig: MakeRig, path: str, turns: int, spoil: Callable[[Rig], None]) -> Rig:
    """Armed, then its daemon dies and another one begins; meanwhile `spoil`."""
    rig = make_rig(path, truth=RobotGroundTruth({"extended": JointGroundTruth(turns=turns)}), start=OUT)
    rig.arm()
    rig.seconds(0.3)
    rig.front.end(0.0)
    rig.front = rig.new_front()
    spoil(rig)
    rig.loop = rig.born(Mode.LIVE)
    rig.news.clear()
    rig.ticks(250)
    return rig


def mute(row: int) -> Callable[[Rig], None]:
    """It hears everything, obeys, and answers nothing."""

    def spoil(rig: Rig) -> None:
        servos = rig.virtual["main"].servos
        servos.memory.store(row, table(1020)["status_return_level"], 0)
        servos.invalidate_cache()

    return spoil


def gone(row: int) -> Callable[[Rig], None]:
    return lambda rig: rig.virtual["main"].faults.silence(row + 1)


def let_go(rig: Rig, what: Any) -> np.ndarray:
    """The way (3,) that each joint made until torque was ordered off, rad."""
    rig.send(what)
    before = rig.truth.copy()
    far = np.zeros(3)
    for _ in range(700):
        rig.ticks(1)
        far = np.maximum(far, np.abs(rig.truth - before))
    return far


@pytest.mark.parametrize("turns", [0, pytest.param(1, marks=pytest.mark.slow), -2])
@pytest.mark.parametrize("what", STOPS)
def test_a_joint_never_read_gets_no_goal_and_the_others_are_lowered(
    make_rig: MakeRig, path: str, turns: int, what: Any
) -> None:
    """Its turn is anybody's guess: the rest pose could be a turn away."""
    rig = inherited(make_rig, path, turns, mute(EXTENDED))
    assert torque_inherited(rig.loop)
    goal = int(rig.register("goal_position")[EXTENDED])
    far = let_go(rig, what)
    assert far[EXTENDED] < 0.005
    assert int(rig.register("goal_position")[EXTENDED]) == goal
    assert np.abs(rig.truth[[SINGLE, CAPPED]]).max() < 0.02
    assert not rig.register("torque_enable").any()
    assert any(
        "the position of extended is unknown" in event.message
        for event in rig.events(ReasonCode.CALIB_MISMATCH)
    )


@pytest.mark.parametrize("what", STOPS)
def test_a_turn_is_determined_though_another_servo_is_missing(
    make_rig: MakeRig, path: str, what: Any
) -> None:
    rig = inherited(make_rig, path, 1, gone(CAPPED))
    assert not rig.loop.hardware.connected
    assert rig.loop.robot.measured.position[:2] == pytest.approx(rig.truth[:2], abs=0.01)
    assert np.isnan(rig.loop.robot.measured.position[CAPPED])
    assert rig.events(ReasonCode.OUT_OF_LIMIT) == []
    assert not rig.loop.identity.verified.joints.any(), "to arm, everybody must be there"
    far = let_go(rig, what)
    assert np.abs(rig.truth[:2]).max() < 0.02, "lowered, not let go where they stood"
    assert far[CAPPED] < 0.005


def test_a_release_of_the_whole_robot_fails_without_motion_and_torque_stays(
    make_rig: MakeRig, path: str
) -> None:
    rig = inherited(make_rig, path, 1, mute(EXTENDED))
    raised = []

    def procedure() -> Any:
        try:
            why = Finding(ReasonCode.NOT_ARMED, message="-")
            yield from rig.loop.commands.release.release(why, SettleProfile(whole=True))
        except BusError as error:
            raised.append(str(error))

    before = rig.truth.copy()
    rig.loop.procedures.beside(procedure())
    rig.seconds(2.0)
    assert raised == ["the position of extended is unknown"]
    assert rig.register("torque_enable").all()
    assert np.abs(rig.truth - before).max() < 0.005


def test_a_starting_daemon_determines_positions_before_it_lowers_the_robot(
    make_rig: MakeRig, path: str
) -> None:
    rig = inherited(make_rig, path, 1, lambda rig: None)
    rig.front.end(0.0)
    rig.front = rig.new_front()
    rig.loop = rig.born(Mode.LIVE)
    for _ in range(20):  # it is identifying: torque was read on, and no turn is known yet
        rig.ticks(1)
        if torque_inherited(rig.loop):
            break
    assert np.isnan(rig.loop.robot.measured.position).any()
    let_go(rig, link.Disarm)
    assert np.abs(rig.truth).max() < 0.02
    assert not rig.register("torque_enable").any()


def test_while_a_limp_servo_restarts_its_position_is_null_and_never_wrong(
    make_rig: MakeRig, path: str
) -> None:
    rig = make_rig(path, truth=RobotGroundTruth({"extended": JointGroundTruth(turns=1)}), start=OUT)
    rig.connect()
    rig.virtual["main"].faults.brown_out(EXTENDED + 1)
    places = []
    for _ in range(60):
        rig.ticks(1)
        [tick] = [news for news in rig.news if isinstance(news, link.Tick)][-1:]
        places.append(np.frombuffer(tick.position)[EXTENDED])
    assert np.isnan(places).any() and not np.isnan(places[-1])
    assert np.nanmax(np.abs(np.array(places) - rig.truth[EXTENDED])) < 0.01
    assert rig.events(ReasonCode.OUT_OF_LIMIT) == []


def test_readings_that_mislead_for_a_while_decide_nothing_for_good(
    make_rig: MakeRig, path: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make_rig(path, truth=RobotGroundTruth({"extended": JointGroundTruth(turns=1)}), start=OUT)
    take = JointReadings.take
    until = 0.3

    def odd(self: JointReadings, number: int, sample: Any) -> Any:
        if rig.clock.now() - began < until:
            sample.position[EXTENDED] -= 4103  # as before its power came, and a few counts
        return take(self, number, sample)

    monkeypatch.setattr(JointReadings, "take", odd)
    began = rig.clock.now()
    rig.seconds(0.8)
    assert rig.loop.identity.troubles == []
    assert rig.loop.robot.measured.position == pytest.approx(rig.truth, abs=0.01)


def test_a_limp_joint_one_turn_off_after_its_return_is_unverified_until_its_turn_is_chosen_anew(
    make_rig: MakeRig,
    path: str,
) -> None:
    rig = make_rig(path, start=OUT)
    rig.connect()
    faults = rig.virtual["main"].faults
    faults.silence(EXTENDED + 1)
    rig.seconds(3.0)
    rig.virtual["main"].servos.power.wind(EXTENDED, 1)
    faults.silence(EXTENDED + 1, False)
    while not rig.loop.robot.measured.heard.all():
        rig.ticks(1)
    assert not rig.loop.identity.verified.joints[EXTENDED]
    rig.seconds(0.5)
    assert rig.loop.identity.verified.joints.all()
    assert rig.loop.identity.troubles == []
    assert rig.loop.robot.measured.position == pytest.approx(rig.truth, abs=0.01)
