"""Topic `raw`: the counts as they were on the wire, from the servos' bytes to a client's JSON."""

import json
from typing import Any

import pytest

from tests.support.daemon_rig import MakeRig, Rig
from tests.support.loop_stand_in import NAMES, briefing, overview, tick
from twind import link
from twind.briefing import JointInfo
from twind.front.state_cache import StateCache
from twind.robot.modes import Mode


def raw_of(news: link.Tick, joints: list[JointInfo]) -> dict[str, Any]:
    """Return the front's raw message of a tick."""
    told = briefing(len(joints))
    world = StateCache(
        type(told)(**{**{f: getattr(told, f) for f in told.__struct_fields__}, "joints": joints})
    )
    world.take(news)
    world.take(overview(0.0, count=len(joints)))
    answer: dict[str, Any] = json.loads(world.raw())
    return answer


def infos(rig: Rig) -> list[JointInfo]:
    return [JointInfo(name, "main", 1, True, -1.0, 1.0) for name in rig.names]


def last(rig: Rig) -> dict[str, Any]:
    return raw_of([news for news in rig.news if isinstance(news, link.Tick)][-1], infos(rig))


def shafts(rig: Rig) -> dict[str, float]:
    names = [joint.name for bus in rig.robot.buses for joint in rig.made.joints(bus.name)]
    return dict(zip(names, rig.counts.tolist(), strict=True))


@pytest.mark.parametrize("mode", [Mode.MIRROR, Mode.LIVE])
@pytest.mark.parametrize("robot", ["h24", "h24-split"])
def test_the_counts_are_the_servos_own_whatever_the_zero(make_rig: MakeRig, robot: str, mode: Mode) -> None:
    rig = make_rig(robot, mode)
    rig.connect()
    raw = last(rig)
    truth = shafts(rig)
    assert raw["names"] == list(rig.names)
    for name, count, age in zip(raw["names"], raw["ticks"], raw["age_ms"], strict=True):
        assert count == pytest.approx(truth[name], abs=1.0)
        assert 0.0 <= age < 10.0


def test_raw_counts_are_null_in_sim(make_rig: MakeRig) -> None:
    rig = make_rig(mode=Mode.SIM)
    rig.ticks(5)
    raw = last(rig)
    assert raw["ticks"] == raw["effort"] == raw["age_ms"] == [None] * 24


def test_the_time_of_a_message_is_that_of_its_reading(live: Rig) -> None:
    live.connect()
    news = [each for each in live.news if isinstance(each, link.Tick)][-1]
    assert news.read == live.loop.robot.measured.time
    assert news.read > news.time  # read after the tick had begun


def test_unknown_efforts_and_missing_counts_are_null() -> None:
    raw = raw_of(tick(50.0, 1), list(briefing().joints))
    assert (raw["effort"][0], raw["effort"][1], raw["effort"][2]) == (0, None, -2)
    assert (raw["ticks"][-1], raw["effort"][-1], raw["age_ms"][-1]) == (None, None, None)
    assert raw["ticks"][3] == 2048 - 300


def test_an_actuator_of_another_name_than_its_joint_goes_by_its_own() -> None:
    joints = list(briefing().joints)
    joints[2] = JointInfo("roll", "main", 3, True, -1.0, 1.0, actuator="motor_a")
    assert raw_of(tick(50.0, 1), joints)["names"][:4] == [*NAMES[:2], "motor_a", NAMES[3]]
