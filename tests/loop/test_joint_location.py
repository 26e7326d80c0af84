"""A waist of 1.5 motor turns, of which no place determines the turn by its count: by a pose, and by its stop.

Whatever the servo counts after its start, the daemon takes the true turn or none, and none silently.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.daemon_rig import Rig
from tests.support.examples import examples, fast_cases
from tests.support.long_waist import PLAIN, STOP, TURN, long_waist_in, started
from tests.support.planar_arm import WAIST
from twind import link
from twind.config.robot_file import load_robot
from twind.config.robot_report import check_robot
from twind.safety.device_rules import DeviceRules

NEAR = 0.02  # rad


@pytest.fixture(scope="module")
def waist(tmp_path_factory: pytest.TempPathFactory) -> str:
    return long_waist_in(tmp_path_factory.mktemp("waist"))


def stands(rig: Rig) -> float:
    """Angle of the waist as the daemon reports it, rad; NaN: unknown."""
    return float(rig.loop.robot.measured.position[rig.names.index(WAIST)])


def located(rig: Rig, angle: float) -> link.Reply:
    return rig.call(link.LocateJoints, joints=[rig.names.index(WAIST)], positions=[angle])


def arms(rig: Rig) -> list[str]:
    """Ask for torque; the codes of the refusal, none where it came on."""
    if rig.loop.condition.state == "calibrating":
        assert rig.call(link.Calibrate, on=False).error is None
    rig.lease()
    reply = rig.call(link.Arm)
    return [] if reply.error is None else [each["code"] for each in reply.parameters["findings"]]


def test_the_robot_file_is_accepted_and_the_remedy_is_shown(waist: str) -> None:
    report = check_robot(load_robot(waist))
    assert report.errors == ()
    assert "after a power-up by `twindctl calibrate turn`: extended (1.50 turns)" in "\n".join(report.lines)


@given(
    angle=st.floats(-STOP, STOP),
    off=st.one_of(st.floats(-0.25, 0.25), st.floats(-2.0 * TURN, 2.0 * TURN)),
    turns=st.integers(-3, 3),
    noise=st.one_of(st.none(), st.integers(0, 9)),
)
@examples(40)
def test_a_pose_gives_the_true_turn_or_a_refusal(
    waist: str, angle: float, off: float, turns: int, noise: int | None
) -> None:
    truth = replace(PLAIN, turns=turns, seam_seed=noise)
    with started(waist, angle, truth) as rig:
        assert np.isnan(stands(rig)), "no place of it is alone on its turn"
        reply = located(rig, angle + off)
        aside = abs(off - TURN * round(off / TURN))
        if abs(off) <= TURN / 8 - 0.01:
            assert reply.error is None, reply
        if aside > TURN / 8 + 0.01:
            assert reply.error == "Refused", reply
        if reply.error is None and abs(off) < TURN / 2:
            assert stands(rig) == pytest.approx(angle, abs=NEAR)
        if reply.error is not None:
            assert np.isnan(stands(rig))
            assert "CALIB_MISMATCH" in arms(rig)


@pytest.mark.parametrize("angle", fast_cases([-1.5, 0.0, 1.5], {-1.5}))
def test_with_its_turn_known_it_arms_and_moves_from_end_to_end(waist: str, angle: float) -> None:
    with started(waist, angle) as rig:
        assert located(rig, angle + 0.1).error is None
        assert arms(rig) == []
        for place in (1.5, -1.5):
            rig.submit(rig.path(WAIST, [place], [6.0]), more=True)
            rig.seconds(6.5)
            assert rig.truth[rig.names.index(WAIST)] == pytest.approx(place, abs=NEAR)
        assert rig.loop.condition.latches == {}


def test_a_restart_of_its_servo_forgets_the_turn(waist: str) -> None:
    with started(waist, 1.2, replace(PLAIN, turns=2)) as rig:
        assert located(rig, 1.2).error is None
        rig.virtual["main"].faults.brown_out(rig.robot.joints[rig.names.index(WAIST)].id)
        rig.seconds(1.5)
        assert np.isnan(stands(rig))
        assert "CALIB_MISMATCH" in arms(rig)


def test_a_known_turn_is_not_changed_by_another_pose(waist: str) -> None:
    with started(waist, 0.5) as rig:
        assert located(rig, 0.5).error is None
        reply = located(rig, 0.5 - TURN)
        assert "its turn is known" in reply.parameters["findings"][0]["message"]
        assert stands(rig) == pytest.approx(0.5, abs=NEAR)


def test_where_it_may_not_be_located_the_reason_is_given(waist: str) -> None:
    with started(waist, 0.5) as rig:
        other = rig.call(link.LocateJoints, client=99, joints=[1], positions=[0.5])
        assert other.parameters["findings"][0]["code"] == "LEASE_MISSING"
        assert located(rig, 9.0).parameters["findings"][0]["code"] == "CALIB_MISMATCH"
        assert rig.call(link.Calibrate, on=False).error is None
        assert located(rig, 0.5).error == "WrongState"


def test_a_joint_that_is_moved_while_it_is_silent_gets_no_turn_by_the_pose_before(waist: str) -> None:
    with started(waist, 0.5) as rig:
        place = rig.names.index(WAIST)
        faults = rig.virtual["main"].faults
        number = rig.robot.joints[place].id
        faults.silence(number)
        rig.ticks(3)
        ticket = rig.send(link.LocateJoints, joints=[place], positions=[0.5])
        rig.ticks(5)
        faults.hand(pose={WAIST: 0.5 - 0.6 * TURN}, speed=20.0)
        rig.seconds(0.5)
        faults.silence(number, on=False)
        rig.seconds(3.0)
        assert rig.replies(ticket)[-1].error == "Refused", rig.replies(ticket)
        assert np.isnan(stands(rig))


# ------------------------------------------------------------------------------- against its stop


def search(rig: Rig, side: str) -> dict[str, Any]:
    """The last reply of a search."""
    place = rig.names.index(WAIST)
    return rig.call(link.FindStop, ticks=12_000, joint=place, side=side, speed=0.5, times=2).parameters


@pytest.mark.parametrize("side", fast_cases(["lower", "upper"], {"lower"}))
@pytest.mark.parametrize("angle", fast_cases([-1.6, -0.6, 0.4, 1.6], {-0.6}))
@pytest.mark.parametrize("turns", fast_cases([0, 2], {2}))
def test_a_search_of_its_stop_gives_the_true_turn_wherever_it_starts(
    waist: str, side: str, angle: float, turns: int
) -> None:
    with started(waist, angle, replace(PLAIN, turns=turns)) as rig:
        reply = search(rig, side)
        assert reply.get("findings") is None and len(reply["ticks"]) == 2, reply
        assert stands(rig) == pytest.approx(float(rig.truth[rig.names.index(WAIST)]), abs=NEAR)
        assert arms(rig) == []


@pytest.mark.parametrize("off", fast_cases([-0.1, 0.0, 0.1], {0.0}))
def test_an_obstacle_a_turn_before_its_stop_is_not_taken_for_it(waist: str, off: float) -> None:
    blocked = replace(PLAIN, stops_rad=(-STOP + TURN + off, STOP))
    with started(waist, 0.8, blocked) as rig:
        reply = search(rig, "lower")
        assert reply["phase"] == "failed"
        assert "in place of its stop" in reply["findings"][0]["message"]
        assert np.isnan(stands(rig))
        assert "CALIB_MISMATCH" in arms(rig)


def test_a_servo_that_restarts_while_its_joint_comes_to_rest_gets_no_turn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its clock may be read too late: silence is all that shows the restart."""
    monkeypatch.setattr(DeviceRules, "_restarts", lambda *_: iter(()))
    with started(long_waist_in(tmp_path, 6.0), -1.2, replace(PLAIN, turns=1)) as rig:
        place = rig.names.index(WAIST)
        rig.send(link.FindStop, joint=place, side="lower", speed=0.5, times=2)
        for _ in range(12_000):
            rig.ticks(1)
            pending = rig.loop.commands.homing.unrestored
            if pending is not None and pending.captures and not rig.loop.torque.energising:
                break
        rig.virtual["main"].faults.brown_out(rig.robot.joints[place].id)
        rig.seconds(4.0)
        assert np.isnan(stands(rig))
        assert "CALIB_MISMATCH" in arms(rig)


def test_a_joint_that_is_moved_while_its_mode_is_restored_keeps_no_turn(waist: str) -> None:
    with started(waist, -1.4) as rig:
        place = rig.names.index(WAIST)
        ticket = rig.send(link.FindStop, joint=place, side="lower", speed=0.5, times=2)
        for _ in range(12_000):
            rig.ticks(1)
            pending = rig.loop.commands.homing.unrestored
            if pending is not None and pending.rest is not None:
                break
        rig.virtual["main"].faults.hand(pose={WAIST: 0.5}, speed=5.0)
        rig.seconds(4.0)
        [reply] = [each for each in rig.replies(ticket) if not each.continues]
        assert reply.parameters["findings"][0]["code"] == "CALIB_MISMATCH"
        assert np.isnan(stands(rig))
