"""A short life, and what weighs it; `make soak` makes it as long as asked for."""

import pytest

from tests.proof.soak.growth import Growth
from tests.proof.soak.life import Life
from tests.proof.soak.living import ROBOTS, robot_of
from twind import link
from twind.robot.modes import RobotState


@pytest.mark.slow
def test_a_minute_of_a_random_life_breaks_no_rule() -> None:
    found = Life(2, "h24").live(1.0 / 60.0)
    assert not found["wrong"], found
    assert found["packets"] > 8_000


@pytest.mark.campaign
def test_six_minutes_of_a_random_life_breaks_no_rule_and_grows_nothing() -> None:
    found = Life(2, "h24").live(0.1)
    assert not found["wrong"], found
    assert sum(found["faults"].values()) > 4
    assert found["packets"] > 50_000


def test_a_joint_that_a_hand_took_out_of_its_travel_is_put_back_by_one() -> None:
    life = Life(3, "h24")
    life.ready()
    life.call(link.EStop, level="cut")
    life.obey({"fault": "hand", "id": 16, "to": 3500, "speed": 10.0})
    life.seconds(2.0)
    life.obey({"fault": "hand", "id": 16, "off": True})
    life.ready()
    assert (life.wrong, life.acts["by hand"], life.rig.loop.condition.state) == ([], 1, RobotState.ARMED)
    life.close()


@pytest.mark.parametrize("robot", ["darwin", "arm-unwatched"])
def test_a_joint_that_a_hand_moves_during_arming_gets_no_old_goal(robot: str) -> None:
    """A goal may switch the torque of such a servo on, and preparing twenty of them takes 0.2 s."""
    life = Life(3, robot)
    life.ready()
    life.call(link.Disarm)
    life.until(lambda: life.rig.loop.condition.state is RobotState.CONNECTED, 10.0)
    device = life.devices["main"][2]
    life.obey({"fault": "hand", "bus": "main", "id": device.id, "rad": device.upper - 0.02, "speed": 0.2})
    life.seconds(0.2)
    life.ready()
    assert not life.wrong
    life.close()


@pytest.mark.parametrize(("leak", "files"), [(0.0, 0), (0.5, 0), (0.0, 1)])
def test_steady_growth_is_found_and_warm_up_is_not(leak: float, files: int) -> None:
    grown = Growth("loop")
    for minute in range(40):
        grown.time.append(60.0 * minute)
        grown.memory.append(80.0 + min(minute, 5) + leak * minute)
        grown.files.append(8 + (files and minute // 20))
    assert bool(grown.wrong()) == bool(leak or files)


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["arm-robstride", "arm-cubemars", "arm-odrive"])
def test_an_arm_whose_bus_was_lost_is_armed_again_and_breaks_no_rule(robot: str) -> None:
    life = Life(1, robot)
    life.ready()
    life.motion_begins()
    life.seconds(0.8)
    life.obey({"fault": "unacknowledged", "bus": "main"})
    life.seconds(0.3)
    assert life.rig.loop.condition.latches
    life.obey({"fault": "unacknowledged", "bus": "main", "on": False})
    life.ready()
    life.seconds(1.0)
    assert (life.wrong, life.rig.loop.condition.state) == ([], RobotState.ARMED)
    life.close()


def test_every_seed_has_its_robot_and_neighbours_differ() -> None:
    assert {robot_of(seed) for seed in range(len(ROBOTS))} == set(ROBOTS)
    assert all(robot_of(seed) != robot_of(seed + 1) for seed in range(len(ROBOTS)))
