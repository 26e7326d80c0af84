"""Text and plots of the viewer, and its error without its libraries."""

import re
from argparse import Namespace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.support.viewer_messages import h24, state, status
from twind.command_line.extras import how_to_add
from twind.command_line.verb import UsageError
from twind.ctl import demo_viewer
from twind.observe import view
from twind.observe.viewing import live_plots, status_html
from twind.observe.viewing.viewer_state import DaemonLost, ViewerState


def test_text_from_messages_never_becomes_markup() -> None:
    evil = "<img src=x onerror=alert(1)>"
    known = ViewerState()
    finding = {"code": evil, "message": evil}
    known.take(
        status(robot=evil, lease={"holder": evil, "uid": 0, "expires_in": 1.0}, faults=[finding], state=evil)
    )
    known.take({"topic": "events", "time": 0.0, "event": {"level": "error", "code": evil, "message": evil}})
    known.take({"topic": "verdicts", "time": 0.0, "verdict": {"refusals": [finding]}})
    assert "<img" not in status_html.page(known.now(), None, None, 0) + status_html.alerts(known.now())
    known.take(DaemonLost(evil))
    assert "<img" not in status_html.page(known.now(), None, None, 0)


def test_alerts_are_one_list_with_ages_the_newest_first() -> None:
    known = ViewerState()
    assert "none" in status_html.alerts(known.now())
    known.take(state(h24(), 20.0))
    event = {"level": "warning", "code": "LOOP_LATE", "message": "late"}
    known.take({"topic": "events", "time": 5.0, "event": event})
    finding = {"code": "POS_LIMIT", "message": "too far"}
    known.take({"topic": "verdicts", "time": 12.0, "verdict": {"refusals": [finding]}})
    known.take({"topic": "events", "time": 18.0, "event": event | {"level": "error", "code": "ESTOP"}})
    text = re.sub(r"<[^>]*>", "|", status_html.alerts(known.now()))
    lines = re.findall(r"(\d+ s)\|+(\w+)", text)
    assert lines == [("2 s", "ESTOP"), ("8 s", "refused"), ("15 s", "LOOP_LATE")]


def test_the_tracking_error_is_that_of_joints_that_have_a_goal() -> None:
    known = ViewerState()
    robot = h24()
    known.take(state(robot, 1.0))
    assert np.isnan(live_plots.tracking(known)[1]).all() and live_plots.worst(known) is None
    known.take(state(robot, 2.0, l_knee={"position": 0.1, "goal": 0.15}, r_knee={"goal": 0.01}))
    time, most, rms = live_plots.tracking(known)
    assert time.tolist() == [-1.0, 0.0]
    assert most[-1] == pytest.approx(50.0)
    assert rms[-1] == pytest.approx(np.sqrt((50.0**2 + 10.0**2) / 2.0))
    names = [joint["name"] for joint in robot["robot"]["joints"]]
    worst = live_plots.worst(known)
    assert worst is not None and names[worst] == "l_knee"
    assert live_plots.joint(known, worst)[2][-1] == pytest.approx(0.1)


def test_in_mirror_the_tracking_error_is_that_of_the_simulation() -> None:
    known = ViewerState()
    robot = h24()
    held = {"position": 0.5, "goal": 0.1, "simulated": 0.09}
    for time, mode in enumerate(("live", "mirror", "sim")):
        known.take(status(mode=mode))
        known.take(state(robot, float(time), l_knee=held))
    assert live_plots.tracking(known)[1] == pytest.approx([400.0, 10.0, 10.0])


@pytest.mark.parametrize("place", [37, 700, 1999])
def test_a_peak_of_one_sample_is_in_the_plots(place: int) -> None:
    known = ViewerState()
    robot = h24()
    for step in range(2000):
        off = 0.3 if step == place else 0.0
        known.take(state(robot, 0.005 * step, l_knee={"position": off, "goal": 0.0}))
    time, most, _ = live_plots.tracking(known)
    assert most.max() == pytest.approx(300.0)
    knee = [joint["name"] for joint in robot["robot"]["joints"]].index("l_knee")
    lines = live_plots.joint(known, knee)
    assert lines[2].max() == pytest.approx(0.3) and lines[0][lines[2].argmax()] == pytest.approx(
        0.005 * (place - 1999)
    )
    assert max(time.size, lines[0].size) <= 2 * live_plots.POINTS and (np.diff(lines[0]) > 0.0).all()


def test_latency_is_plotted_by_hop() -> None:
    known = ViewerState()
    hops = [{"hop": "total", "now_ms": 3.0}, {"hop": "twin", "now_ms": None}]
    known.take({"topic": "latency", "time": 1.0, "latency": hops})
    time, total, twin, *_ = live_plots.latency(known)
    assert (time.tolist(), total.tolist()) == ([0.0], [3.0])
    assert np.isnan(twin).all()


def test_a_missing_viewer_library_is_reported_with_its_install_command(monkeypatch: Any, capsys: Any) -> None:
    monkeypatch.setattr(view, "find_spec", lambda name: None)
    with pytest.raises(UsageError, match=re.escape(how_to_add("view"))):
        view.run(Namespace(port=None))
    monkeypatch.setattr(demo_viewer, "find_spec", lambda name: None)
    with demo_viewer.viewer("nowhere", lambda: None):
        said = capsys.readouterr().out
    assert said.count("\n") == 1 and how_to_add("view") in said


@given(st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=40))
@example([10.0, -5e-324])  # divided by a step it is nothing
def test_known_values_are_inside_the_axis_range(values: list[float]) -> None:
    least, most = live_plots.extent((np.array([np.nan, *values]),))
    assert least < most and all(least <= value <= most for value in values)
    assert live_plots.extent((np.array([np.nan]),)) == (0.0, 1.0)
