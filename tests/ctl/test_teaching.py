"""`twindctl teach` without a daemon: samples, keys, and motions that the real gate judges."""

import os
from math import pi
from typing import Any

import numpy as np
import pytest

from twind.config.robot_file import load_robot
from twind.ctl.offline_check import verdict
from twind.ctl.teaching.hand_recorder import GAP, LONGEST, HandRecorder
from twind.ctl.teaching.key_input import KeyInput
from twind.ctl.teaching.taught_motion import TaughtMotion, VerdictMessage, passed_by_gate, taught_motion
from twind.motion.hand_path import HandPath
from twind.twin.binding import Binding, bind

JOINTS = ("l_shoulder_pitch", "l_elbow")


def state(time: float, *positions: float, **changed: Any) -> dict[str, Any]:
    rows = [
        {"name": name, "position": at, "heard": True, "torque": False}
        for name, at in zip(JOINTS, positions, strict=True)
    ]
    rows[-1] |= {key: value for key, value in changed.items() if key != "mode"}
    return {"time": time, "mode": changed.get("mode", "mirror"), "joints": rows}


def recorder_of(*states: dict[str, Any], seconds: float | None = None) -> HandRecorder:
    recorder = HandRecorder(JOINTS, 0.01, seconds)
    for each in states:
        recorder.take(each)
    return recorder


# ------------------------------------------------------------------------------------------ samples


def test_samples_are_the_states_in_their_order() -> None:
    path = recorder_of(state(5.0, 0.1, 0.2), state(5.01, 0.11, 0.21)).path()
    assert path is not None
    assert path.time.tolist() == [5.0, 5.01]
    assert path.position.tolist() == [[0.1, 0.2], [0.11, 0.21]]


@pytest.mark.parametrize("silent", [{"heard": False}, {"position": None}])
def test_a_short_silence_is_bridged_and_counted(silent: dict[str, Any]) -> None:
    states = [state(0.01 * k, 0.0, 0.0, **(silent if 3 <= k < 8 else {})) for k in range(12)]
    recorder = recorder_of(*states)
    path = recorder.path()
    assert path is not None
    assert len(path.time) == 7
    assert (recorder.bridged, recorder.ended) == (1, "")


def test_ticks_at_uneven_times_are_no_gaps() -> None:
    assert (
        recorder_of(*(state(time, 0.0, 0.0) for time in (0.0, 0.018, 0.02, 0.03, 0.044, 0.05))).bridged == 0
    )


def test_a_long_silence_ends_the_recording_and_keeps_what_came_before() -> None:
    states = [state(0.01 * k, 0.0, 0.0, **({"heard": False} if k >= 3 else {})) for k in range(40)]
    recorder = recorder_of(*states, state(0.41, 0.0, 0.0))
    assert recorder.ended == f"no reading of l_elbow for {GAP:g} s"
    assert recorder.seconds == pytest.approx(0.02)


def test_a_gap_between_messages_ends_it_too() -> None:
    recorder = recorder_of(state(0.0, 0.0, 0.0), state(0.01, 0.0, 0.0), state(0.2, 1.0, 1.0))
    assert "the daemon" in recorder.ended
    assert recorder.seconds == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("changed", "reason"),
    [({"torque": True}, "torque came on: l_elbow"), ({"mode": "sim"}, "the mode was changed to sim")],
)
def test_a_joint_that_no_hand_moves_ends_it(changed: dict[str, Any], reason: str) -> None:
    recorder = recorder_of(state(0.0, 0.0, 0.0), state(0.01, 0.0, 0.0), state(0.02, 1.0, 1.0, **changed))
    assert recorder.ended == reason
    assert recorder.seconds == pytest.approx(0.01)


@pytest.mark.parametrize("seconds", [None, 2.0])
def test_it_ends_after_its_time(seconds: float | None) -> None:
    recorder = recorder_of(*(state(0.05 * k, 0.0, 0.0) for k in range(1300)), seconds=seconds)
    assert recorder.ended
    assert recorder.seconds == pytest.approx(seconds or LONGEST, abs=0.051)


def test_one_sample_is_no_path() -> None:
    assert recorder_of(state(0.0, 0.0, 0.0), state(0.0, 0.0, 0.0)).path() is None


def test_each_enter_counts_once_and_the_end_of_input_is_noticed() -> None:
    reader, writer = os.pipe()
    try:
        keys = KeyInput(reader)
        assert not keys.pressed()
        os.write(writer, b"\n\n")
        assert [keys.pressed() for _ in range(3)] == [True, True, False]
        assert not keys.ended
        os.close(writer)
        assert not keys.pressed()
        assert keys.ended
    finally:
        os.close(reader)


# ------------------------------------------------------------------------------------------ the gate


@pytest.fixture(scope="module")
def h24() -> Binding:
    return bind(load_robot("h24"), None)


def swing(seconds: float, *reach: float, count: int = 1) -> HandPath:
    """Both joints to their reach and back, `count` times, from the rest pose."""
    time = np.arange(0.0, seconds, 0.01)
    share = np.sin(count * pi * time / seconds) ** 2
    return HandPath(time, share[:, None] * np.array(reach))


def passed(
    h24: Binding, path: HandPath, joints: tuple[str, ...] = JOINTS
) -> tuple[TaughtMotion, VerdictMessage]:
    rest = np.zeros(len(h24.joint_map.names))
    return passed_by_gate(taught_motion(joints, path, 0.01, 1.0), lambda sent: verdict(h24, rest, sent))


def test_a_slow_motion_within_the_limits_is_left_as_it_is(h24: Binding) -> None:
    motion, judged = passed(h24, swing(4.0, -0.8, -0.9))
    assert not judged["refusals"]
    assert (motion.added, motion.reasons, motion.clipped()) == (0.0, {}, {})
    assert motion.deviation().size <= 0.01 + 1e-6
    assert motion.trajectory()["points"][0]["time_from_start"] == 1.0


def test_a_motion_that_is_too_fast_is_slowed_down_where_it_is(h24: Binding) -> None:
    quick = swing(0.7, -0.9, -0.9).position
    slow = swing(4.0, -0.8, -0.9).position
    rows = np.concatenate([slow, quick, slow])
    path = HandPath(0.01 * np.arange(len(rows)), rows)
    motion, judged = passed(h24, path)
    assert not judged["refusals"]
    assert ("VEL_LIMIT", "l_elbow") in motion.reasons
    assert 0.0 < motion.added < 0.7  # not the eight slow seconds
    assert motion.slowest > 1.0
    assert motion.deviation().time <= np.ptp(path.time)  # the hand's, not of the slowed path
    assert motion.reasons["VEL_LIMIT", "l_elbow"].endswith(" rad/s") and not motion.still
    assert motion.deviation().size <= 0.01 + 1e-6


def test_a_jump_of_the_readings_still_becomes_a_motion(h24: Binding) -> None:
    path = swing(4.0, -0.8, -0.9)
    path.position[150:] += 0.1
    motion, judged = passed(h24, path)
    assert not judged["refusals"]
    assert motion.deviation().size <= 0.01 + 1e-6


def test_positions_beyond_the_limits_are_moved_into_them(h24: Binding) -> None:
    motion, judged = passed(h24, swing(4.0, -0.8, 0.13))  # the elbow ends at 0.1
    assert not judged["refusals"]
    assert list(motion.clipped()) == ["l_elbow"]
    assert 0.03 <= motion.clipped()["l_elbow"] <= 0.06
    assert max(point["positions"][1] for point in motion.trajectory()["points"]) <= 0.1


def test_a_joint_that_stays_outside_is_not_moved_further_and_further(h24: Binding) -> None:
    asked = 0

    def refuse(_: dict[str, Any]) -> VerdictMessage:
        nonlocal asked
        asked += 1
        return {"refusals": [{"code": "POS_LIMIT", "joint": "l_elbow", "value": -0.95, "bound": -0.85}]}

    motion, _ = passed_by_gate(taught_motion(JOINTS, swing(4.0, -0.8, -0.9), 0.01, 1.0), refuse)
    assert motion.clipped()["l_elbow"] == pytest.approx(0.08, abs=1e-6)
    assert asked == 4


def test_a_hand_that_was_cut_in_motion_passes(h24: Binding) -> None:
    path = swing(4.0, -0.8, -0.9)
    motion, judged = passed(h24, HandPath(path.time[:150], path.position[:150]))
    assert not judged["refusals"]
    assert motion.trajectory()["points"][-1]["velocities"] == [0.0, 0.0]


def test_what_neither_limits_nor_speed_correct_is_still_refused(h24: Binding) -> None:
    joints = ("l_shoulder_roll", "l_shoulder_yaw", "l_elbow", "l_shoulder_pitch")
    motion, judged = passed(h24, swing(4.0, 0.0, -1.4, -2.1, -0.3), joints)
    assert {each["code"] for each in judged["refusals"]} == {"SELF_COLLISION"}
    assert motion.added == 0.0
