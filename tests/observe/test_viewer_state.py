"""State of the viewer: what it keeps, the age of the state, and invalid messages."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from tests.support.viewer_messages import h24, other, state, status
from twind.observe.viewing import robot_viewer, status_html
from twind.observe.viewing.robot_model import RobotModel
from twind.observe.viewing.robot_scene import CONTACT, marked
from twind.observe.viewing.viewer_state import WINDOW, News, RobotAnnounced, ViewerState
from twind_drivers.clock import FakeClock


def test_an_invalid_message_is_reported_and_the_next_is_shown() -> None:
    known = ViewerState()
    robot = h24()
    seen: list[tuple[str | None, bool]] = []

    def news() -> Iterator[News]:
        for each in (RobotAnnounced(robot), {"topic": "state"}, state(robot, 1.0)):
            yield each
            seen.append((known.now().lost, known.now().joints is not None))
        raise OSError("the file is gone")

    robot_viewer.take(known, news())
    assert seen[0] == (None, False)
    assert "KeyError" in str(seen[1][0]) and not seen[1][1]
    assert seen[2] == (None, True)
    assert known.now().lost == "the messages have ended: OSError: the file is gone"


def test_the_age_of_the_state_is_shown_and_red_from_one_second() -> None:
    clock = FakeClock()
    known = ViewerState(clock.now)
    robot = h24()
    assert "s ago" not in status_html.page(known.now(), None, None, 0)
    known.take(state(robot))
    clock.time = 0.9
    assert "less than 1 s ago" in status_html.page(known.now(), None, None, 0)
    clock.time = 12.0
    said = status_html.page(known.now(), None, None, 0)
    assert status_html.row("heard", "12 s ago: the picture is old", status_html.RED) in said
    known.take(status())  # says nothing of joints
    assert "12 s ago" in status_html.page(known.now(), None, None, 0)


def test_the_viewer_state_keeps_the_latest_values_within_its_window() -> None:
    known = ViewerState()
    robot = h24()
    known.take(RobotAnnounced(robot))
    for step in range(40):
        known.take(state(robot, 0.5 * step, head_yaw=0.01 * step))
    path = known.path()
    assert path[-1].measured[0] == pytest.approx(0.39)
    assert path[-1].time - path[0].time <= WINDOW
    known.take(state(robot, 0.0))  # a recording that began anew
    assert [each.time for each in known.path()] == [0.0]
    known.take(RobotAnnounced(other()))
    assert known.now().joints is None and known.path() == []


def test_only_refusals_warnings_and_errors_are_kept() -> None:
    known = ViewerState()
    good: dict[str, Any] = {"refusals": [], "warnings": [], "changes": []}
    bad = good | {"refusals": [{"code": "POS_LIMIT", "message": "too far"}]}
    for time, verdict in enumerate((good, bad)):
        known.take({"topic": "verdicts", "time": float(time), "verdict": verdict})
    for level in ("info", "warning"):
        event = {"level": level, "code": "X", "message": "m"}
        known.take({"topic": "events", "time": 0.0, "event": event})
    known.take({"topic": "trajectories", "time": 0.0, "accepted": {}})  # of a newer daemon
    assert [each["time"] for each in known.now().refusals] == [1.0]
    assert [each["event"]["level"] for each in known.now().events] == ["warning"]


def test_a_joint_in_contact_is_named_and_its_body_marked() -> None:
    known = ViewerState()
    robot = h24()
    known.take(state(robot, l_elbow={"external_nm": 2.0, "external_sd_nm": 0.1, "contact": True}))
    now = known.now()
    names = [joint["name"] for joint in robot["robot"]["joints"]]
    elbow = names.index("l_elbow")
    assert now.joints is not None and now.joints.external[elbow] == 2.0
    assert np.isnan(np.delete(now.joints.external, elbow)).all()
    (row,) = status_html.joints(now, names)
    assert "contact" in row and "l_elbow" in row
    model = RobotModel(robot)
    assert marked(now, model) == {int(model.bodies_of[elbow]): CONTACT}


def test_a_joint_is_stale_if_its_age_is_high_or_unknown() -> None:
    known = ViewerState()
    robot = h24()
    silent = {"heard": False, "age_ms": 900.0}
    known.take(state(robot, head_yaw={"age_ms": 90.0}, head_pitch={"age_ms": None}, l_elbow=silent))
    now = known.now()
    assert now.joints is not None
    old = [joint["name"] for joint, each in zip(robot["robot"]["joints"], now.stale, strict=True) if each]
    assert old == ["head_yaw", "head_pitch"]  # who is not heard at all is marked as that
