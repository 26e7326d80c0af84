"""The contact that keeps a joint from turning: the deepest between what it moves and the rest."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.hull_robot import hull
from twind.config.robot_file import load_robot
from twind.robot.arrays import Floats
from twind.twin.binding import Binding, bind
from twind.twin.simulation import Simulation, hush

HEAD, TAIL, ARM, HAND = range(4)
FREE = {"option": '<flag filterparent="disable"/>'}  # so that the overlapping hull touches everywhere


@pytest.fixture(autouse=True)
def _quiet() -> None:
    hush()


def after(binding: Binding, goal: Floats, seconds: float = 3.0) -> Simulation:
    simulation = Simulation(binding, 0.01)
    for _ in range(round(seconds / 0.01)):
        simulation.step(goal)
    return simulation


def test_the_blocked_joint_has_a_contact_and_the_others_have_none(tmp_path: Path) -> None:
    simulation = after(bind(hull(tmp_path), None), np.array([0.0, 0.0, 0.0, -1.5]))
    found = simulation.contact(HAND)
    assert found is not None
    assert found.bodies == ("hand", "torso")
    assert 0.0 < found.depth < 0.01
    assert simulation.contact(HEAD) is None
    assert simulation.contact(TAIL) is None


def test_a_contact_counts_for_every_joint_between_the_two_bodies(tmp_path: Path) -> None:
    simulation = after(bind(hull(tmp_path), None), np.array([0.0, 0.0, 0.0, -1.5]))
    assert simulation.contact(ARM) == simulation.contact(HAND)


def test_without_contacts_there_is_none(tmp_path: Path) -> None:
    simulation = after(bind(hull(tmp_path), None), np.zeros(4), 0.1)
    assert [simulation.contact(joint) for joint in range(4)] == [None] * 4


def test_the_deepest_contact_is_chosen(tmp_path: Path) -> None:
    """The face overlaps the torso by 50 mm, the head by 40 mm and the nose by 30 mm."""
    simulation = Simulation(bind(hull(tmp_path, **FREE), None), 0.01)
    simulation.step(None)
    found = [simulation.contact(joint) for joint in (HEAD, TAIL)]
    bodies = [contact.bodies for contact in found if contact is not None]
    assert bodies == [("face", "torso"), ("tail", "backpack")]


def test_the_ground_that_a_free_standing_robot_stands_on_does_not_count() -> None:
    robot = load_robot("h24")
    knee = robot.names.index("l_knee")
    free = after(bind(replace(robot, support="free"), None), np.zeros(24), 0.2)
    assert free.data.ncon > 0
    assert free.contact(knee) is None


def test_a_pinned_robot_that_pushes_on_the_ground_names_it(tmp_path: Path) -> None:
    robot = hull(tmp_path)
    low = robot.mjcf.replace('name="torso" pos="0 0 0.6"', 'name="torso" pos="0 0 0.12"')
    (tmp_path / "hull.xml").write_text(low)
    found = after(bind(robot, None), np.zeros(4), 0.2).contact(HAND)
    assert found is not None
    assert found.bodies[1] == "floor"
