"""Balance of a free-standing robot (UNSTABLE_POSE): the feet, the hull of their corners, and the warnings."""

from math import nan
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.support.dynamics_rig import judge, pose
from tests.support.free_standing_h24 import free_h24
from twind.config.robot_file import load_robot
from twind.robot.finding import ReasonCode
from twind.twin.binding import Binding, bind
from twind.twin.mirror import index
from twind.twin.standing_feet import INSIDE, StandingFeet, inside, tipping

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.5, 0.5]])


@pytest.fixture(scope="module")
def free(tmp_path_factory: pytest.TempPathFactory) -> Binding:
    return bind(load_robot(str(free_h24(tmp_path_factory.mktemp("free")))), None)


def stance(binding: Binding, **angles: float) -> tuple[list[str], float]:
    """Names of the feet on the floor, lowest first, and the margin."""
    data = mujoco.MjData(binding.model)
    balance = StandingFeet(binding, binding.model, data)
    data.qpos[index(binding.qpos)] = pose(binding, **angles)
    stands = balance.stand()
    return [binding.model.body(body).name for body in stands.feet], stands.margin


@pytest.mark.parametrize(
    ("place", "expected"),
    [((0.5, 0.5), 0.5), ((0.2, 0.5), 0.2), ((0.0, 0.5), 0.0), ((1.3, 0.5), -0.3), ((0.9, 0.95), 0.05)],
)
def test_inside_is_the_distance_to_the_nearest_edge(place: tuple[float, float], expected: float) -> None:
    assert inside(SQUARE, np.array(place)) == pytest.approx(expected)


def test_beyond_a_corner_and_on_a_line_and_at_a_point_nothing_is_inside() -> None:
    assert -np.hypot(1, 1) <= inside(SQUARE, np.array([2.0, 2.0])) < 0.0
    line = np.array([[0.0, 0.0], [1.0, 0.0]])
    assert inside(line, np.array([0.5, 0.0])) == 0.0
    assert inside(line, np.array([0.5, 0.1])) == pytest.approx(-0.1)
    assert inside(line[:1], np.array([3.0, 4.0])) == pytest.approx(-5.0)
    assert np.isnan(inside(line, np.array([nan, 0.0]))) and np.isnan(inside(line * nan, np.zeros(2)))


def test_inside_agrees_with_many_directions() -> None:
    random = np.random.default_rng(3)
    turn = np.linspace(0.0, 2.0 * np.pi, 20_000)
    ways = np.stack([np.cos(turn), np.sin(turn)])
    for _ in range(50):
        points = random.normal(size=(8, 2))
        place = random.normal(size=2)
        sampled = ((points @ ways).max(axis=0) - place @ ways).min()
        found = inside(points, place)
        assert (found > 0) == (sampled > 0)
        if sampled > 0.0:
            assert found == pytest.approx(sampled, abs=1e-3)


def test_upright_both_feet_stand_and_the_mass_is_between_them(free: Binding) -> None:
    feet, margin = stance(free)
    assert sorted(feet) == ["l_foot", "r_foot"]
    assert margin == pytest.approx(
        0.048, abs=0.001
    )  # to the heel: a foot reaches 0.048 m back from the ankle


@pytest.mark.parametrize(("lifted", "other"), [("l", "r"), ("r", "l")])
def test_with_one_foot_lifted_the_other_stands_alone(free: Binding, lifted: str, other: str) -> None:
    bent = {f"{lifted}_hip_pitch": -0.7, f"{lifted}_knee": 1.4, f"{lifted}_ankle_pitch": -0.7}
    feet, margin = stance(free, **bent)
    assert feet == [f"{other}_foot"]
    assert margin == pytest.approx(-0.013, abs=0.005)  # a foot's inner edge is 13 mm off the middle


def test_over_the_standing_foot_the_robot_stands(free: Binding) -> None:
    bent = {"l_hip_pitch": -0.7, "l_knee": 1.4, "l_ankle_pitch": -0.7}
    leaning = {"r_hip_roll": 0.15, "r_ankle_roll": -0.15, "l_hip_roll": 0.15, "r_shoulder_roll": -1.2}
    turned = {
        name: -angle for name, angle in leaning.items() if name.startswith("r_") and "should" not in name
    }
    margins = [stance(free, **bent, **{**leaning, **other})[1] for other in ({}, turned)]
    assert max(margins) > INSIDE > min(margins)


def test_the_robot_leans_with_its_ankles(free: Binding) -> None:
    forward = [stance(free, l_ankle_pitch=a, r_ankle_pitch=a)[1] for a in (0.0, 0.1, 0.2, 0.3)]
    assert forward[0] > forward[-1] and forward[-1] < 0.0


def test_excessive_leaning_is_reported_once_with_first_and_worst_time(free: Binding) -> None:
    lean = np.array([pose(free, l_ankle_pitch=a, r_ankle_pitch=a) for a in np.linspace(0.0, 0.3, 31)])
    verdict = judge(free, np.concatenate([lean, lean[::-1]]))
    (found,) = verdict.warnings
    assert verdict.accepted and found.code is ReasonCode.UNSTABLE_POSE
    assert found.time is not None and 0.0 < found.time < 0.5
    assert found.value is not None and found.value < 0.0 and found.bound == INSIDE
    assert "least at 0.49" in found.message or "least at 0.5" in found.message


def test_the_edge_of_the_bound() -> None:
    time = np.array([0.0, 1.0])
    assert tipping(time, np.array([0.05, INSIDE]), known=True) == []
    assert len(tipping(time, np.array([0.05, np.nextafter(INSIDE, 0.0)]), known=True)) == 1
    (unknown,) = tipping(time, np.array([nan, 0.05]), known=True)
    assert unknown.time == 0.0


def test_a_robot_without_contacts_is_reported_as_not_checkable(tmp_path: Path) -> None:
    path = free_h24(tmp_path)
    model = tmp_path / "h24.xml"
    bare = model.read_text().replace('contype="1" conaffinity="1"', 'contype="0" conaffinity="0"')
    model.write_text(bare.replace('name="floor" type="plane"', 'name="floor" type="plane" contype="1"'))
    binding = bind(load_robot(str(path)), None)
    verdict = judge(binding, np.tile(binding.rest, (20, 1)))
    (found,) = verdict.warnings
    assert found.code is ReasonCode.UNSTABLE_POSE and "cannot be judged" in found.message


SHAPES = {
    "sphere": 'type="sphere" size="0.02"',
    "capsule": 'type="capsule" size="0.01 0.05"',
    "cylinder": 'type="cylinder" size="0.05 0.01"',
}


@pytest.mark.parametrize(
    ("shape", "margin"), [("sphere", (-1.0, 0.001)), ("capsule", (-1.0, 0.02)), ("cylinder", (0.03, 0.05))]
)
def test_feet_of_other_shapes(tmp_path: Path, shape: str, margin: tuple[float, float]) -> None:
    path = free_h24(tmp_path)
    model = tmp_path / "h24.xml"
    text = model.read_text()
    box = 'type="box" pos="0.012 0 -0.025" size="0.06 0.032 0.01"'
    assert text.count(box) == 2
    model.write_text(text.replace(box, SHAPES[shape] + ' pos="0 0 -0.025"'))
    binding = bind(load_robot(str(path)), None)
    feet, found = stance(binding)
    assert sorted(feet) == ["l_foot", "r_foot"]
    assert margin[0] <= found <= margin[1]
