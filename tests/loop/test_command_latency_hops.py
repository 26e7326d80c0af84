"""Command latency of a whole daemon in every mode: real bytes, fake time."""

from typing import Any

import numpy as np
import pytest

from tests.support.daemon_rig import MakeRig, Rig
from twind import link
from twind.robot.modes import Mode
from twind.robot.trajectory import Trajectory
from twind.telemetry.rolling_stats import BOUNDS_MS
from twind.telemetry.timing_monitor import COMMAND

JOINT = "l_elbow"
WHOLE = dict.fromkeys(COMMAND, 1)
JUDGED = {"received": 1, "gated": 1}


@pytest.fixture(params=[Mode.LIVE, Mode.MIRROR, Mode.SIM])
def ready(make_rig: MakeRig, request: pytest.FixtureRequest) -> Rig:
    """One that takes commands: armed in live; elsewhere the simulation follows."""
    rig: Rig = make_rig(mode=request.param)
    if request.param is Mode.LIVE:
        rig.arm()
    else:
        rig.ticks(30)
        rig.lease()
    return rig


def bent(rig: Rig, by: float, time: float = 1.0) -> Trajectory:
    here = float(rig.loop.executor.reference.position[rig.names.index(JOINT)])
    return rig.path(JOINT, [here - by], [time])


def called(rig: Rig) -> dict[str, float]:
    return {"received": rig.clock.now() - 0.004}


def stream(rig: Rig, by: float, count: int) -> None:
    """Setpoints, one a tick, each so much further."""
    joint = rig.names.index(JOINT)
    for _ in range(count):
        place = float(rig.loop.executor.reference.position[joint]) - by
        rig.send(link.Setpoint, joints=[joint], positions=[place], **called(rig))
        rig.ticks(1)


def figures(rig: Rig) -> dict[str, int]:
    windows = rig.loop.parts.health.hops
    return {name: windows[name].count for name in COMMAND if windows[name].count}


def last(rig: Rig) -> dict[str, link.LatencyInfo]:
    overview = [news for news in rig.news if isinstance(news, link.Overview)][-1]
    return {each.hop: each for each in overview.latencies}


def test_a_trajectory_has_a_figure_of_every_hop(ready: Rig) -> None:
    ready.submit(bent(ready, 0.3), **called(ready))
    ready.seconds(0.5)
    assert figures(ready) == WHOLE
    told = last(ready)
    assert 4.0 <= told["received"].now_ms < 4.0 + 2.0 * ready.loop.robot.period * 1e3
    assert told["received"].now_ms <= told["command"].now_ms
    assert 1.0 < told["moved"].now_ms < 150.0
    assert all(told[hop].violations == 0 for hop in COMMAND)


def test_each_setpoint_of_a_stream_has_latency_figures_and_only_its_start_a_motion_figure(ready: Rig) -> None:
    stream(ready, 0.02, 20)
    ready.ticks(5)
    assert figures(ready) == {"received": 20, "gated": 20, "written": 20, "moved": 1, "command": 20}


def test_a_trajectory_stopped_before_its_first_goal_has_no_motion_figures(ready: Rig) -> None:
    ready.submit(bent(ready, 0.3), **called(ready))
    ready.send(link.Cancel)
    ready.seconds(0.3)
    assert figures(ready) == JUDGED
    joint = ready.names.index(JOINT)
    place = float(bent(ready, 0.1).position[0, joint])
    ready.send(link.Setpoint, joints=[joint], positions=[place], **called(ready))
    ready.send(link.Cancel)
    ready.seconds(0.3)
    assert figures(ready) == {"received": 2, "gated": 2}


def test_a_waiting_refused_or_checked_trajectory_has_no_later_latency_figures(ready: Rig) -> None:
    ready.submit(bent(ready, 0.3), check_only=True, **called(ready))
    ready.ticks(3)
    assert figures(ready) == {}
    ready.submit(bent(ready, 9.0), **called(ready))
    ready.ticks(3)
    assert figures(ready) == JUDGED
    ready.submit(bent(ready, 0.3), start_in=0.1, **called(ready))
    ready.seconds(0.5)
    assert figures(ready) == {"received": 2, "gated": 2}


def test_a_change_of_mode_ends_what_was_looked_for(make_rig: MakeRig) -> None:
    rig = make_rig(mode=Mode.MIRROR)
    rig.ticks(30)
    rig.lease()
    rig.submit(bent(rig, 0.3), **called(rig))
    rig.ticks(2)
    assert figures(rig)["written"] == 1
    rig.call(link.SetMode, mode="sim")
    rig.seconds(1.0)
    assert "moved" not in figures(rig)


# ------------------------------------------------------------------------------------- alerts


def latency_events(rig: Rig) -> list[tuple[str, str]]:
    found: list[Any] = [event for event in rig.events() if event.code.startswith("LATENCY")]
    return [(event.code, event.message) for event in found]


def test_a_late_setpoint_stream_is_reported_once_and_its_recovery_once(ready: Rig) -> None:
    joint = ready.names.index(JOINT)
    place = float(ready.loop.executor.reference.position[joint])
    for late in [0.08] * 20 + [0.004] * 150:
        fields = {"joints": [joint], "positions": [place], "received": ready.clock.now() - late}
        ready.send(link.Setpoint, **fields)
        ready.ticks(1)
    messages = latency_events(ready)
    assert [code for code, _ in messages] == ["LATENCY_WARN"] * 2 + ["LATENCY_CALM"] * 2
    assert [message.split()[0] for _, message in messages] == ["received", "command"] * 2
    assert "40 ms" in messages[-1][1]
    (warning,) = [event for event in ready.events("LATENCY_WARN") if event.message.startswith("received")]
    assert (warning.level, warning.findings[0].bound) == ("warning", 0.05)
    assert warning.findings[0].value > 0.08


def test_latency_reports_end_when_the_robot_is_no_longer_read(make_rig: MakeRig) -> None:
    rig = make_rig(mode=Mode.MIRROR)
    rig.ticks(30)
    rig.lease()
    rig.loop.parts.health.hop("reply", 0.08, rig.clock.now())
    rig.call(link.SetMode, mode="sim")
    assert [message for _, message in latency_events(rig)] == [
        "reply is above its threshold",
        "reply is not measured any longer: no robot is read",
    ]


def test_a_trajectory_that_was_long_judged_is_no_alarm(ready: Rig) -> None:
    ready.submit(bent(ready, 0.1), received=ready.clock.now() - 3.0)
    ready.seconds(0.2)
    assert last(ready)["received"].now_ms > 3000.0
    assert latency_events(ready) == []


# ------------------------------------------------------------------------------------- as it is told


def test_an_old_command_latency_is_not_reported_as_current(ready: Rig) -> None:
    ready.submit(bent(ready, 0.1), **called(ready))
    ready.seconds(4.5)
    assert last(ready)["command"].now_ms is not None
    ready.seconds(1.0)
    told = last(ready)["command"]
    assert told.now_ms is None
    assert told.mean_ms == pytest.approx(told.p50_ms, rel=0.03)


def test_histograms_come_once_a_second_and_count_every_value_of_the_run(ready: Rig) -> None:
    ready.submit(bent(ready, 0.3), **called(ready))
    ready.news.clear()
    ready.seconds(5.0)
    overviews = [news for news in ready.news if isinstance(news, link.Overview)]
    whole = [each for each in overviews if each.loop.lateness is not None]
    steps = np.diff([each.time for each in whole])
    assert len(overviews) > 45
    assert np.all((steps > 0.85) & (steps < 1.15))
    for each in whole:
        counts = {hop.hop: [bucket.count for bucket in hop.histogram] for hop in each.latencies}
        assert sum(counts["received"]) == (1 if each.time > whole[0].time else sum(counts["received"]))
        assert sum(bucket.count for bucket in each.loop.lateness) == each.loop.ticks
    assert [bucket.upper_ms for bucket in whole[-1].loop.lateness] == [*BOUNDS_MS, None]
    told = next(hop for hop in whole[-1].latencies if hop.hop == "command")
    assert told.histogram_sum_ms == pytest.approx(told.mean_ms)
    lean = next(each for each in overviews if each.loop.lateness is None)
    assert all(hop.histogram is None and hop.histogram_sum_ms is None for hop in lean.latencies)
