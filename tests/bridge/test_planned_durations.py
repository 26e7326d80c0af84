"""How far a motion is: the share of its planned time, never its end."""

from typing import Any

from twind.bridge.uplink.planned_durations import KEPT, MOST, PlannedDurations


def accepted(name: str, time: float, lasts: float, start_in: float | None = None) -> dict[str, Any]:
    path = {"joint_names": [], "points": [{"time_from_start": 0.0}, {"time_from_start": lasts}]}
    if start_in is not None:
        path["start_in"] = start_in  # type: ignore[assignment]
    return {"topic": "trajectories", "time": time, "accepted": {"id": name, "trajectory": path}}


def test_it_grows_from_its_start_and_never_says_that_it_is_over() -> None:
    plans = PlannedDurations()
    plans.on_monitor_reply(accepted("a", 10.0, 4.0))
    plans.on_monitor_reply(accepted("b", 10.0, 4.0, start_in=2.0))
    assert [plans.share("a", now) for now in (9.0, 10.0, 12.0, 14.0, 99.0)] == [0.0, 0.0, 0.5, MOST, MOST]
    assert [plans.share("b", now) for now in (11.0, 14.0)] == [0.0, 0.5]


def test_of_what_was_not_heard_nothing_is_done_and_what_is_old_is_forgotten() -> None:
    plans = PlannedDurations()
    for number in range(KEPT + 1):
        plans.on_monitor_reply(accepted(str(number), 0.0, 1.0))
    assert plans.share("0", 0.5) == 0.0
    assert plans.share(str(KEPT), 0.5) == 0.5
