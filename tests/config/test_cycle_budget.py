"""The cycle budget of a robot: what fits, and the arithmetic of what does not."""

import re
from dataclasses import replace

import pytest

from tests.support.doc_pages_text import ROOT
from twind.config.cycle_budget import budgets, require_rate
from twind.config.robot_file import load_robot
from twind.config.robot_spec import RobotFile
from twind.config.yaml_tree import ConfigError


def with_type(robot: RobotFile, **changes: object) -> RobotFile:
    kind = replace(robot.joints[0].type, **changes)
    return replace(robot, joints=tuple(replace(joint, type=kind) for joint in robot.joints))


@pytest.mark.parametrize("name", ["h24", "h24-split"])
def test_the_built_in_robots_reach_100_hz_plain_and_fast_with_upkeep(name: str) -> None:
    for each in require_rate(load_robot(name), 100.0):
        assert each.plain.reachable_hz > 100.0
        assert each.fast.reachable_hz > each.plain.reachable_hz


def test_each_bus_with_joints_has_one_budget() -> None:
    robot = load_robot("h24-split")
    assert [(each.bus.name, each.count) for each in budgets(robot, 100.0)] == [("upper", 12), ("lower", 12)]
    alone = replace(robot, joints=tuple(joint for joint in robot.joints if joint.bus == "upper"))
    assert [each.bus.name for each in budgets(alone, 100.0)] == ["upper"]


def test_a_rate_beyond_the_wire_is_refused_with_the_arithmetic() -> None:
    with pytest.raises(ConfigError) as caught:
        require_rate(load_robot("h24"), 1000.0)
    for part in ("bus main", "1000 Hz leaves 1000 us a cycle", "the bus needs", "bytes =", "at 2000000 baud"):
        assert part in str(caught.value)


def test_factory_settings_cannot_do_100_hz() -> None:
    robot = load_robot("h24")
    slow_bus = replace(robot, buses=(replace(robot.buses[0], baud=57_600),))
    slow_timer = replace(robot, buses=(replace(robot.buses[0], latency_timer_ms=16),))
    for each in (slow_bus, slow_timer):
        with pytest.raises(ConfigError, match="100 Hz leaves"):
            require_rate(each, 100.0)
    [delayed] = budgets(with_type(robot, return_delay_us=500), 100.0)
    assert delayed.plain.refusal(100.0) is not None


def test_a_budget_text_gives_bytes_microseconds_and_reachable_rate() -> None:
    [each] = budgets(load_robot("h24"), 100.0)
    text = "\n".join(each.lines)
    assert "24 servos at 2000000 baud, 100 Hz wanted" in text
    assert (
        f"{each.plain.bytes} bytes, {each.plain.seconds * 1e6:.0f} us, up to {each.plain.reachable_hz:.0f} Hz"
        in text
    )


def test_the_page_of_small_computers_has_the_rates_of_the_budget() -> None:
    page = (ROOT / "docs" / "small-computers.md").read_text()
    robot = load_robot("h24")
    found = re.search(r"24 servos, fast reads: (\d+) Hz at 1 M, (\d+) at 2 M, (\d+) at 3 M", page)
    assert found is not None
    for rate, baud in zip(found.groups(), (1_000_000, 2_000_000, 3_000_000), strict=True):
        (budget,) = budgets(replace(robot, buses=(replace(robot.buses[0], baud=baud),)), 200.0)
        assert int(budget.fast.reachable_hz + 0.5) == int(rate)
