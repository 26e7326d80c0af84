"""The fail-safe on real bytes under a fake clock: what it lowers, what it leaves alone, and what it says."""

from dataclasses import replace
from pathlib import Path
from socket import AF_UNIX, SOCK_DGRAM, socket

import numpy as np
import pytest

from tests.support.daemon_rig import MakeRig, Rig
from tests.support.described_robot import redescribe
from tests.support.failsafe_rig import RAISED, failsafe_of, given_up, off_rest, run, torque
from twind.loop.procedures import failsafe
from twind.loop.procedures.failsafe import FailsafeRun
from twind.loop.procedures.internal_faults import inhibit
from twind.loop.process.service_notify import Notifier
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode

SLOW_FIXED = pytest.param("fixed", marks=pytest.mark.slow)
SLOW_FREE = pytest.param("free", marks=pytest.mark.slow)
SHARE = 0.0135  # of the speed that joints have: 29 s to the rest pose


@pytest.mark.parametrize("support", ["gantry", SLOW_FIXED, "free", "stilts"])
def test_a_robot_that_is_whole_is_lowered_to_its_rest_pose_and_let_go(support: str) -> None:
    with given_up(support=support) as rig:
        assert off_rest(rig) > 0.7
        assert (rig.register("bus_watchdog") == 255).all()  # tripped
        assert run(rig).left == ""
        assert off_rest(rig) < 0.05
        assert not torque(rig).any()
        assert not rig.events("DAMP")


def test_the_fail_safe_lowers_at_a_quarter_of_every_velocity_limit() -> None:
    with given_up() as rig:
        safe = failsafe_of(rig)
        fastest = np.zeros(24)
        safe.begin()
        before = rig.loop.robot.written
        while not rig.loop.condition.finished:
            rig.ticks(1)
            if before is not None and rig.loop.robot.written is not None:
                fastest = np.maximum(fastest, np.abs(rig.loop.robot.written - before) / rig.loop.robot.period)
            before = rig.loop.robot.written
        assert fastest.max() > 0.1
        assert (fastest <= 0.25 * rig.loop.robot.limits.velocity + 1e-9).all()


def test_nothing_is_written_where_no_torque_is_on(make_rig: MakeRig) -> None:
    rig = make_rig(start=RAISED, rate_hz=50.0)
    before = rig.counts
    goals = rig.register("goal_position").copy()
    assert run(rig, 2.0).left == ""
    assert np.array_equal(rig.counts, before)
    assert np.array_equal(rig.register("goal_position"), goals)
    assert not rig.register("bus_watchdog").any()


def test_the_fail_safe_in_mode_mirror_leaves_inherited_torque_and_reports_it() -> None:
    with given_up(mode=Mode.MIRROR) as rig:
        before = rig.counts
        assert "mode mirror of the settings writes nothing" in run(rig).left
        assert torque(rig).all()
        assert np.array_equal(rig.counts, before)
        assert rig.loop.hardware.writers == []


def test_mode_mirror_is_content_where_torque_is_off(make_rig: MakeRig) -> None:
    rig = make_rig(mode=Mode.MIRROR)
    assert run(rig, 2.0).left == ""


@pytest.mark.parametrize("support", ["gantry", SLOW_FIXED])
def test_a_robot_that_is_carried_is_lowered_without_a_servo_that_is_missing(support: str) -> None:
    with given_up(support=support) as rig:
        rig.virtual["main"].faults.silence(20)
        left = run(rig).left
        place = rig.robot.joints.index(next(joint for joint in rig.robot.joints if joint.id == 20))
        assert rig.names[place] in left
        assert torque(rig).tolist() == [int(joint.id == 20) for joint in rig.robot.joints]
        assert off_rest(rig) < 0.05  # the one that is silent was there already


@pytest.mark.parametrize("support", ["free", pytest.param("stilts", marks=pytest.mark.slow)])
def test_a_robot_that_stands_freely_is_left_standing_where_a_servo_is_missing(support: str) -> None:
    with given_up(support=support) as rig:
        rig.virtual["main"].faults.silence(5)
        before = rig.counts
        began = rig.clock.now()
        left = run(rig).left
        assert "not every device is there" in left
        assert "id 5" in left
        assert failsafe.WAIT <= rig.clock.now() - began < failsafe.WAIT + 1.0
        assert torque(rig).all()
        assert np.array_equal(rig.counts, before)


def test_a_robot_that_stands_freely_is_left_where_a_leg_has_no_torque_and_lowered_where_an_arm_has_none() -> (
    None
):
    with given_up(support="free") as rig:
        knee = rig.names.index("l_knee")
        rig.virtual["main"].servos.torque(knee, False)
        assert "it is not on in l_knee" in run(rig).left
        assert int(torque(rig).sum()) == 23
    with given_up(support="free") as rig:
        rig.virtual["main"].servos.torque(rig.names.index("l_elbow"), False)
        assert run(rig).left == ""
        assert not torque(rig).any()


@pytest.mark.parametrize("support", ["gantry", "free"])
def test_the_fail_safe_moves_no_robot_with_a_joint_beyond_its_hard_limit(support: str) -> None:
    with given_up(support=support, killed=False, l_knee=2.4) as rig:
        before = rig.counts
        assert "to hold l_knee inside the hard limits would be a step" in run(rig).left
        assert torque(rig).all()
        assert np.array_equal(rig.counts, before)


def test_a_joint_on_its_hard_limit_is_no_obstacle() -> None:
    with given_up(killed=False, l_knee=2.2505) as rig:  # a count beyond, as encoders have it
        assert run(rig).left == ""
        assert off_rest(rig) < 0.05


@pytest.mark.parametrize("support", ["gantry", "free"])
def test_the_fail_safe_moves_no_robot_with_a_zero_other_than_calibrated(support: str) -> None:
    with given_up(support=support) as rig:
        servos = rig.virtual["main"].servos
        servos.memory.store(5, servos.memory.tables[5]["homing_offset"], 300)
        before = rig.counts
        assert "CALIB_MISMATCH" in run(rig).left
        assert torque(rig).all()
        assert np.array_equal(rig.counts, before)


def test_a_port_that_is_gone_is_waited_for_and_no_longer() -> None:
    with given_up() as rig:
        rig.virtual["main"].faults.unplug()
        began = rig.clock.now()
        left = run(rig).left
        assert failsafe.WAIT <= rig.clock.now() - began < failsafe.WAIT + 1.0
        assert "no such port" in left
        assert "not known" in left


def test_a_port_that_comes_back_in_time_is_lowered() -> None:
    with given_up() as rig:
        rig.virtual["main"].faults.unplug()
        safe = failsafe_of(rig)
        safe.begin()
        rig.seconds(failsafe.WAIT / 2)
        rig.virtual["main"].faults.replug()
        rig.seconds(10.0)
        assert rig.loop.condition.finished
        assert safe.left == ""
        assert off_rest(rig) < 0.05


def test_a_bus_that_goes_on_the_way_down_is_waited_for_once_more() -> None:
    with given_up(support="free") as rig:
        safe = failsafe_of(rig)
        safe.begin()
        rig.seconds(2.0)
        assert rig.loop.torque.armed
        rig.virtual["main"].faults.unplug()
        rig.seconds(1.0)
        rig.virtual["main"].faults.replug()
        rig.seconds(12.0)
        assert rig.loop.condition.finished
        assert safe.left == ""
        assert off_rest(rig) < 0.05
        assert not torque(rig).any()


def test_a_bus_that_stays_away_on_the_way_down_ends_it_with_what_is_not_known() -> None:
    with given_up(support="free") as rig:
        safe = failsafe_of(rig)
        safe.begin()
        rig.seconds(2.0)
        rig.virtual["main"].faults.unplug()
        rig.seconds(failsafe.WAIT + 2.0)
        assert rig.loop.condition.finished
        assert "not known" in safe.left


def slow_down(rig: Rig, share: float) -> None:
    """Every joint may be only so fast."""
    slow = replace(rig.loop.robot.limits, velocity=rig.loop.robot.limits.velocity * share)
    redescribe(rig.loop, limits=slow)
    rig.loop.executor.limits = slow
    rig.loop.parts.guard.limit(slow, rig.loop.robot.description.ratings)


@pytest.mark.parametrize("support", ["gantry", SLOW_FREE])
def test_a_bus_lost_twice_leaves_torque_on_and_is_reported(support: str) -> None:
    """After `AGAIN` s no way is begun: a robot that could be lowered by then still has its torque."""
    with given_up(support=support) as rig:
        slow_down(rig, 0.05)
        safe = failsafe_of(rig)
        safe.begin()
        for there, gone in ((8.0, 9.0), (1.5, 2.0)):
            rig.seconds(there)
            assert rig.loop.torque.armed
            rig.virtual["main"].faults.unplug()
            rig.seconds(gone)
            rig.virtual["main"].faults.replug()
        while not rig.loop.condition.finished:
            rig.ticks(1)
        assert torque(rig).all()
        assert "torque could not be read back off" in safe.left
        assert rig.events("FAILSAFE")[-1].level == "error"


@pytest.mark.slow
def test_the_worst_sequence_of_delays_ends_within_the_longest_time() -> None:
    """A bus that is there just in time, twice; a way that is long; the bus gone shortly before its end."""
    with given_up() as rig:
        slow_down(rig, SHARE)
        faults = rig.virtual["main"].faults
        began = rig.clock.now()
        faults.unplug()
        safe = failsafe_of(rig)
        safe.begin()
        rig.seconds(failsafe.WAIT - 1.0)
        faults.replug()
        rig.seconds(1.5)
        assert rig.loop.torque.armed
        faults.unplug()
        rig.seconds(began + failsafe.AGAIN - 1.5 - rig.clock.now())
        faults.replug()
        rig.seconds(28.0)
        assert rig.loop.torque.armed
        faults.unplug()
        while not rig.loop.condition.finished:
            rig.ticks(1)
        assert "not known" in safe.left
        took = rig.clock.now() - began
        assert failsafe.AGAIN + failsafe.WITHIN < took < failsafe.LONGEST


def test_the_service_manager_is_asked_for_the_longest_time_when_it_begins(tmp_path: Path) -> None:
    address = str(tmp_path / "notify")
    with given_up() as rig, socket(AF_UNIX, SOCK_DGRAM) as manager:
        manager.bind(address)
        manager.settimeout(1.0)
        notifier = Notifier({"NOTIFY_SOCKET": address})
        loop = rig.loop
        FailsafeRun(loop, loop.identity, loop.commands.release, notifier).begin()
        assert manager.recv(100).decode() == f"EXTEND_TIMEOUT_USEC={failsafe.LONGEST * 1e6:.0f}"
        notifier.close()


def test_a_robot_without_any_reply_is_reported_as_unknown() -> None:
    with given_up() as rig:
        for id in range(1, 25):
            rig.virtual["main"].faults.silence(id)
        assert "power?" in run(rig).left


def test_a_stop_during_the_wait_ends_the_fail_safe_at_once_without_a_write() -> None:
    with given_up() as rig:
        rig.virtual["main"].faults.silence(3)
        safe = failsafe_of(rig)
        safe.begin()
        rig.seconds(1.0)
        safe.stop()
        rig.ticks(3)
        assert rig.loop.condition.finished
        assert "was ended" in safe.left
        assert torque(rig).all()


def test_a_stop_on_the_way_down_does_not_interrupt_the_fail_safe() -> None:
    with given_up() as rig:
        safe = failsafe_of(rig)
        safe.begin()
        rig.seconds(1.5)
        assert rig.loop.torque.armed
        safe.stop()
        rig.seconds(6.0)
        assert rig.loop.condition.finished
        assert safe.left == ""
        assert off_rest(rig) < 0.05


def test_a_stop_while_a_lost_bus_is_waited_for_ends_the_fail_safe_and_lowers_nothing() -> None:
    """A daemon that ends lowers what comes back at half speed, also a standing robot without one leg."""
    with given_up(support="free") as rig:
        safe = failsafe_of(rig)
        safe.begin()
        rig.seconds(2.0)
        assert rig.loop.torque.armed
        rig.virtual["main"].faults.unplug()
        rig.seconds(1.0)
        safe.stop()
        rig.ticks(2)
        assert rig.loop.condition.finished
        assert "PORT_LOST" in safe.left
        rig.virtual["main"].faults.replug()
        before = rig.counts
        rig.seconds(3.0)
        assert torque(rig).all()
        assert np.abs(rig.counts - before).max() <= 2


def test_a_leg_that_confirms_torque_off_late_does_not_keep_its_torque() -> None:
    """The robot sits, and torque of one knee reads on: that is no robot to be left standing."""
    with given_up(support="free") as rig:
        safe = failsafe_of(rig)
        safe.begin()
        knee = rig.names.index("l_knee")
        ordered = None
        while not rig.loop.condition.finished:
            rig.ticks(1)
            if ordered is None and rig.loop.torque.unconfirmed:
                ordered = rig.clock.now()
            if ordered is not None and rig.clock.now() - ordered < 1.6:
                rig.virtual["main"].servos.torque(knee, True)
        assert safe.left == ""
        assert not torque(rig).any()


@pytest.mark.parametrize("before_the_end", [0.32, 0.42, 0.5])
def test_the_fail_safe_drops_no_robot_whose_devices_are_still_being_identified_at_the_end_of_the_wait(
    before_the_end: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A port comes back at the last moment, and a silent servo makes the identification take longer."""
    with given_up() as rig:
        rig.virtual["main"].faults.silence(20)
        rig.virtual["main"].faults.unplug()
        monkeypatch.setattr(failsafe, "WAIT", 1.2 + before_the_end)
        safe = failsafe_of(rig)
        safe.begin()
        rig.seconds(1.0)
        rig.virtual["main"].faults.replug()
        before = rig.counts
        while not rig.loop.condition.finished:
            rig.ticks(1)
        assert "not known" in safe.left
        assert torque(rig).all()
        assert np.array_equal(rig.counts, before)


@pytest.mark.slow
def test_a_bus_that_is_lost_at_the_take_over_does_not_keep_the_arms_from_being_lowered() -> None:
    with given_up("h24-mixed") as rig:
        safe = failsafe_of(rig)
        safe.begin()
        while rig.loop.procedures.rank is None:
            rig.ticks(1)
        rig.ticks(1)
        assert not rig.loop.torque.armed
        rig.virtual["r_leg"].faults.unplug()
        while not rig.loop.condition.finished:
            rig.ticks(1)
        assert "not known of r_hip_yaw" in safe.left
        assert off_rest(rig) < 0.1


def test_a_servo_that_does_not_take_the_goal_leaves_a_robot_that_stands_freely_as_it_is() -> None:
    with given_up(support="free") as rig:
        safe = failsafe_of(rig)
        safe.begin()
        while not rig.loop.hardware.connected:
            rig.ticks(1)
        rig.virtual["main"].faults.silence(9)  # heard a moment ago: judged whole
        before = rig.counts
        begun = rig.clock.now()
        while not rig.loop.condition.finished and rig.clock.now() - begun < 40.0:
            rig.ticks(1)
        rig.seconds(0.5)
        assert rig.loop.condition.finished
        assert safe.left
        assert torque(rig).all()
        assert np.abs(rig.counts - before).max() <= 2


def test_an_inhibit_ends_the_way_down_and_torque_stays() -> None:
    with given_up() as rig:
        safe = failsafe_of(rig)
        safe.begin()
        rig.seconds(1.5)
        assert rig.loop.torque.armed
        inhibit(rig.loop, Finding(ReasonCode.FOREIGN_TRAFFIC, message="a stranger"), rig.clock.now())
        rig.seconds(1.0)
        assert rig.loop.condition.finished
        assert "a stranger" in safe.left
        assert torque(rig).all()


@pytest.mark.slow
def test_both_kinds_of_bus_are_lowered() -> None:
    with given_up("h24-mixed") as rig:
        assert run(rig).left == ""
        assert off_rest(rig) < 0.1
