"""Progress of a motion: the share of its planned time, never its end."""

from typing import Any

from twind.bridge.uplink.uplink_goals import KEPT_PLANS, MOST_SHARE, PlannedDurations


def accepted(name: str, time: float, lasts: float, start_in: float | None = None) -> dict[str, Any]:
    path = {"joint_names": [], "points": [{"time_from_start": 0.0}, {"time_from_start": lasts}]}
    if start_in is not None:
        path["start_in"] = start_in  # type: ignore[assignment]
    return {"topic": "trajectories", "time": time, "accepted": {"id": name, "trajectory": path}}


def test_the_share_grows_from_the_start_of_a_motion_and_never_reaches_its_end() -> None:
    plans = PlannedDurations()
    plans.on_monitor_reply(accepted("a", 10.0, 4.0))
    plans.on_monitor_reply(accepted("b", 10.0, 4.0, start_in=2.0))
    assert [plans.share("a", now) for now in (9.0, 10.0, 12.0, 14.0, 99.0)] == [
        0.0,
        0.0,
        0.5,
        MOST_SHARE,
        MOST_SHARE,
    ]
    assert [plans.share("b", now) for now in (11.0, 14.0)] == [0.0, 0.5]


def test_an_unknown_motion_has_share_zero_and_old_plans_are_dropped() -> None:
    plans = PlannedDurations()
    for number in range(KEPT_PLANS + 1):
        plans.on_monitor_reply(accepted(str(number), 0.0, 1.0))
    assert plans.share("0", 0.5) == 0.0
    assert plans.share(str(KEPT_PLANS), 0.5) == 0.5
