"""`twindctl tune follow`: bounds from what was recorded, never from a joint that was blocked."""

import json
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.support.doc_pages_text import ROOT
from twind.command_line.verb import Rejected
from twind.ctl.ctl_main import main
from twind.observe.recording.recording_columns import Floats, RecordedMessage, RobotRecording
from twind.observe.tuning.follow_survey import JointLag, survey_follow, yaml_text

RATE = 100.0
LIVE = {"mode": "live", "state": "armed"}


def recording(
    measured: Floats,
    goal: Floats,
    events: Sequence[RecordedMessage] = (),
    statuses: Sequence[RecordedMessage] = (RecordedMessage(0.0, LIVE),),
    time: Floats | None = None,
) -> RobotRecording:
    """A recording of one joint, or of several (k, n), at 100 Hz."""
    goal = goal.reshape(len(goal), -1)
    measured = measured.reshape(goal.shape)
    unknown = np.full_like(goal, np.nan)
    return RobotRecording(
        path=Path("swing.mcap"),
        start_ns=1_800_000_000_000_000_000,
        joints=tuple(f"joint_{place}" for place in range(goal.shape[1])),
        time=np.arange(len(goal)) / RATE if time is None else time,
        measured=measured,
        velocity=unknown,
        effort=unknown,
        goal=goal,
        simulated=unknown,
        events=tuple(events),
        statuses=tuple(statuses),
    )


def swing(seconds: float = 10.0, size: float = 0.8) -> Floats:
    """A goal to and fro, 2.5 rad/s at most."""
    return size * np.sin(np.pi * np.arange(seconds * RATE) / RATE)


def lagging(goal: Floats, lag: float) -> Floats:
    """A first-order servo `lag` s behind the goal of the tick before."""
    place = np.zeros(len(goal))
    for k in range(1, len(goal)):
        place[k] = place[k - 1] + (goal[k - 1] - place[k - 1]) * (1.0 - np.exp(-1.0 / RATE / lag))
    return place


def only(made: RobotRecording) -> JointLag:
    (found,) = survey_follow(made)
    return found


def fault(time: float, value: float | None = 0.21, joint: str = "joint_0") -> RecordedMessage:
    finding = {"code": "FOLLOW_ERR", "joint": joint, "value": value, "bound": 0.2}
    return RecordedMessage(time, {"code": "FOLLOW_ERR", "level": "error", "findings": [finding]})


def test_a_stiff_joint_keeps_the_default() -> None:
    goal = swing()
    found = only(recording(lagging(goal, 0.03), goal))
    assert found.worst < 0.03
    assert (found.rad, found.seconds, found.note, found.proposed) == (0.2, 0.1, "", False)
    assert yaml_text([found]) == ""


def test_a_soft_joint_gets_a_quarter_more_than_what_was_recorded() -> None:
    goal = swing()
    found = only(recording(lagging(goal, 0.15), goal))
    assert 0.2 < found.p99 <= found.worst < 0.4
    assert found.above > 0.1
    assert found.rad == pytest.approx(1.25 * found.worst, abs=0.011)
    assert yaml.safe_load(yaml_text([found])) == {
        "joints": {"joint_0": {"follow_rad": found.rad, "follow_s": 0.1}}
    }


def test_the_bound_would_not_have_latched_and_the_default_would() -> None:
    goal = swing()
    made = recording(lagging(goal, 0.2), goal)
    found = only(made)
    assert found.rad is not None and found.rad > found.worst
    assert found.above >= 0.1


def test_a_short_peak_gets_a_time_and_no_wider_bound() -> None:
    goal = swing()
    place = lagging(goal, 0.03)
    place[400:408] = goal[400:408] - 0.55
    found = only(recording(place, goal))
    assert (found.rad, found.seconds) == (0.5, pytest.approx(0.16, abs=0.03))


def test_a_peak_that_would_be_damped_at_once_widens_the_bound() -> None:
    goal = swing()
    place = lagging(goal, 0.03)
    place[400:402] = goal[400:402] - 0.6
    found = only(recording(place, goal))
    assert found.rad == pytest.approx(1.25 * found.worst - 0.3, abs=0.011)


@pytest.mark.parametrize("moved", [0.0, 0.09])
def test_a_joint_that_moved_too_little_says_so_and_gets_nothing(moved: float) -> None:
    goal = swing(size=moved / 2.0)
    found = only(recording(goal - 0.3, goal))
    assert (found.rad, found.seconds, found.note) == (None, None, "moved too little")


def test_what_no_robot_file_may_state_is_not_proposed() -> None:
    goal = swing()
    found = only(recording(goal - 1.4, goal))
    assert found.rad is None and "raise its gain" in found.note


@pytest.mark.parametrize("state_by", ["status", "event"])
def test_a_blocked_joint_is_reported_and_not_hidden(state_by: str) -> None:
    goal = swing()
    place = lagging(goal, 0.03)
    place[310:] = place[310]  # blocked; latched at 3.3 s
    latched = RecordedMessage(3.3, {"code": "fault", "level": "error", "findings": []})
    events = [fault(3.3, 0.31)] + ([latched] if state_by == "event" else [])
    statuses = [RecordedMessage(0.0, LIVE)]
    if state_by == "status":
        statuses += [RecordedMessage(3.3, LIVE | {"state": "fault"})]
    found = only(recording(place, goal, events, statuses))
    assert found.worst < 0.06
    assert (found.rad, found.proposed) == (0.2, False)
    assert found.note == "FOLLOW_ERR at 3.30 s (0.31 rad) is left out"


def test_the_other_joints_of_a_fault_count_until_it() -> None:
    goal = np.column_stack([swing(), swing()])
    place = np.column_stack([lagging(swing(), 0.15), lagging(swing(), 0.15)])
    statuses = [RecordedMessage(0.0, LIVE), RecordedMessage(2.0, LIVE | {"state": "fault"})]
    first, second = survey_follow(recording(place, goal, [fault(0.1)], statuses))
    assert "left out" in first.note and not second.note
    assert second.worst > 0.2


def test_a_fault_without_a_value_and_one_of_an_unknown_joint_are_no_error() -> None:
    goal = swing()
    found = only(recording(goal, goal, [fault(1.0, None), fault(2.0, 0.3, "absent")]))
    assert found.note == "FOLLOW_ERR at 1.00 s (nan rad) is left out"


def test_a_load_at_rest_is_asked_about() -> None:
    goal = np.concatenate([swing(2.0), np.zeros(800)])
    place = lagging(goal, 0.03)
    place[400:] = -0.3
    assert only(recording(place, goal)).note == "worst while its goal stands: load, or an obstacle?"


def test_gaps_and_readings_that_are_missing_are_no_lag() -> None:
    goal = swing()
    place = lagging(goal, 0.03)
    place[100:150] = np.nan
    time = np.arange(len(goal)) / RATE
    time[500:] += 3.0
    found = only(recording(place, goal, time=time))
    assert found.worst < 0.06 and found.rad == 0.2
    empty = only(recording(np.full(500, np.nan), swing(5.0)))
    assert (empty.rad, empty.note) == (None, "no reading of the armed robot")
    assert only(recording(np.zeros(1), np.zeros(1))).rad is None


def test_a_robot_without_torque_does_not_count() -> None:
    goal = swing()
    statuses = [RecordedMessage(0.0, LIVE | {"state": "connected"})]
    assert only(recording(goal - 0.4, goal, statuses=statuses)).note == "no reading of the armed robot"


# ------------------------------------------------------------------------------------------- the verb


def test_the_verb_reads_a_flight_file(capsys: pytest.CaptureFixture[str]) -> None:
    capture = str(ROOT / "tests" / "data" / "captures" / "overload.flight")
    assert main(["tune", "follow", capture, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    rows = {row["joint"]: row for row in answer["joints"]}
    assert (rows["head_yaw"]["rad"], rows["head_yaw"]["proposed"]) == (0.2, False)
    assert rows["l_knee"]["note"] == "moved too little" and rows["l_knee"]["rad"] is None
    assert answer["yaml"] == ""
    assert main(["tune", "follow", capture]) == 0
    text = capsys.readouterr().out
    assert "follow_rad" in text and text.rstrip().endswith("the default fits the joints that moved")


def test_the_verb_prints_keys_that_a_robot_file_takes(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    goal = swing()
    made = recording(lagging(goal, 0.15), goal)
    monkeypatch.setattr("twind.observe.tuning.follow_table.open_recording", lambda path: made)
    assert main(["tune", "follow", "swing.mcap"]) == 0
    text = capsys.readouterr().out
    found = yaml.safe_load(text[text.index("joints:\n") :])
    assert found["joints"]["joint_0"]["follow_s"] == 0.1


def test_a_simulation_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    from twind.observe.tuning import follow_table

    goal = swing()
    made = recording(goal, goal, statuses=[RecordedMessage(0.0, {"mode": "sim", "state": "disconnected"})])
    monkeypatch.setattr(follow_table, "open_recording", lambda path: made)
    with pytest.raises(Rejected, match="no reading of mode live"):
        follow_table.show_follow(Namespace(json=False), Path("swing.mcap"))
