"""Distances of bodies: the judged pairs, and that no distance is overstated."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.support.clearance_rig import Oracle, arm, arm_file, h24
from twind.config.robot_file import read_robot
from twind.exceptions import InvalidInput
from twind.robot.finding import ReasonCode
from twind.twin.binding import Binding, bind
from twind.twin.collision_model import CollisionModel, candidates
from twind.twin.simulation import hush

FLOOR = '<geom name="floor" type="plane" size="2 2 0.1"/>'
WALL = '<geom name="wall" type="box" pos="0.6 0 0.3" size="0.02 0.5 0.5"/>'


@pytest.fixture(scope="module")
def robot() -> Binding:
    return h24()


def poses(binding: Binding, count: int, share: float) -> np.ndarray:
    random = np.random.default_rng(3)
    wide = binding.limits.upper - binding.limits.lower
    found = binding.rest + (random.random((count, len(binding.rest))) - 0.5) * share * wide
    return np.asarray(np.clip(found, binding.limits.lower, binding.limits.upper))


def test_the_pairs_are_those_that_mujoco_itself_looks_at(robot: Binding) -> None:
    spec = mujoco.MjSpec.from_string(robot.mjcf)
    for geom in spec.geoms:
        geom.margin = 5.0
    spec.delete(next(geom for geom in spec.geoms if geom.name == "floor"))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_collision(model, data)
    theirs = {frozenset(model.geom(int(g)).name for g in pair) for pair in data.contact.geom}
    ours = {frozenset(robot.model.geom(g).name for g in pair.geoms) for pair in CollisionModel(robot).pairs}
    assert ours == theirs


@pytest.mark.parametrize("share", [0.3, 0.7])
def test_a_distance_is_what_mujoco_measures_up_to_the_reach(robot: Binding, share: float) -> None:
    bodies = CollisionModel(robot)
    oracle = Oracle(robot, [pair.geoms for pair in bodies.pairs])
    places = poses(robot, 150, share)
    found = bodies.distances(places)
    boxes = np.isin(np.arange(len(bodies.pairs)), bodies.boxes)
    assert boxes.any()
    touching = 0
    for row, place in zip(found, places, strict=True):
        truth = oracle.row(place)
        near = ~boxes & (truth < bodies.reach)
        assert row[near] == pytest.approx(truth[near], abs=1e-9)
        assert (row[~near] == bodies.reach).all()
        bodies.place(place)
        measured = [bodies.between(pair, 1.0) for pair in bodies.boxes]
        assert measured == pytest.approx(truth[boxes].tolist(), abs=1e-9)
        touching += int((truth < 0.0).any())
    assert touching > 10


def test_a_model_of_another_reach_measures_as_one_that_was_made_for_it(robot: Binding) -> None:
    places = poses(robot, 20, 0.5)
    near = CollisionModel(robot, 0.05)
    short = near.distances(places)
    far = near.reaching(0.2)
    made = CollisionModel(robot, 0.2)
    assert (near.reach, far.reach) == (0.05, made.reach)
    assert np.array_equal(far.distances(places), made.distances(places))
    assert np.array_equal(near.distances(places), short)
    assert not np.array_equal(far.distances(places), short)


def test_no_pair_comes_closer_than_its_levers_allow(robot: Binding) -> None:
    bodies = CollisionModel(robot)
    oracle = Oracle(robot, [pair.geoms for pair in bodies.pairs])
    starts = poses(robot, 60, 1.0)
    ends = poses(robot, 120, 1.0)[60:]
    tightest = 0.0
    for one, other in zip(starts, ends, strict=True):
        for share in (1.0, 0.1, 0.01):
            there = one + share * (other - one)
            first = oracle.row(one)
            last = oracle.row(there)
            outside = (first > 0.0) & (last > 0.0) & (first < 1.0) & (last < 1.0)
            bound = bodies.levers @ np.abs(there - one)
            assert (np.abs(first - last)[outside] <= bound[outside] + 1e-9).all()
            moved = outside & (bound > 1e-6)
            tightest = max(tightest, float((np.abs(first - last)[moved] / bound[moved]).max(initial=0.0)))
    assert tightest > 0.5  # else the levers would prove little


def test_each_lever_is_reached_by_some_pose(tmp_path: Path) -> None:
    """Stretched out, the tip of an arm moves as far as its levers say: they are bounds, and tight ones."""
    binding = arm(tmp_path)
    bodies = CollisionModel(binding)
    pair = next(k for k, pair in enumerate(bodies.pairs) if pair.bodies == ("base", "tip"))
    assert bodies.levers[pair] == pytest.approx([0.43, 0.23, 0.03])
    elbow = next(k for k, pair in enumerate(bodies.pairs) if pair.bodies == ("base", "middle"))
    assert bodies.levers[elbow] == pytest.approx([0.2 + 0.15 + 0.02, 0.15 + 0.02, 0.0])


def test_an_allowed_pair_is_not_checked(tmp_path: Path) -> None:
    everything = {pair.bodies for pair in CollisionModel(arm(tmp_path)).pairs}
    assert everything == {("base", "upper"), ("base", "middle"), ("base", "tip"), ("upper", "tip")}
    some = {pair.bodies for pair in CollisionModel(arm(tmp_path, "{allow: [[tip, base]]}")).pairs}
    assert some == everything - {("base", "tip")}
    only = {
        pair.bodies for pair in CollisionModel(arm(tmp_path, "{pairs: [[tip, base], [upper, tip]]}")).pairs
    }
    assert only == {("base", "tip"), ("upper", "tip")}


@pytest.mark.parametrize(
    ("collision", "message"),
    [
        (
            "{allow: [[tipp, base]]}",
            "collision.allow: the model has no body and no geom 'tipp'; nearest: tip",
        ),
        ("{pairs: [[upper, middle]]}", "the model never lets [upper, middle] collide"),
        ("{pairs: [[tip, base]], allow: [[base, tip]]}", "or `allow` does"),
    ],
)
def test_names_that_mean_nothing_are_refused(tmp_path: Path, collision: str, message: str) -> None:
    with pytest.raises(InvalidInput) as caught:
        CollisionModel(arm(tmp_path, collision))
    assert message in str(caught.value)


def test_the_world_counts_where_the_base_has_a_place_in_it(tmp_path: Path) -> None:
    def codes(support: str, collision: str = "{}") -> set[ReasonCode]:
        binding = arm(tmp_path, collision, support=support, world=FLOOR + WALL)
        return {pair.code for pair in CollisionModel(binding).pairs}

    assert codes("gantry") == {ReasonCode.SELF_COLLISION}
    assert codes("fixed") == {ReasonCode.SELF_COLLISION, ReasonCode.FLOOR, ReasonCode.KEEP_OUT}
    assert codes("gantry", "{world: true}") == {
        ReasonCode.SELF_COLLISION,
        ReasonCode.FLOOR,
        ReasonCode.KEEP_OUT,
    }
    assert codes("fixed", "{world: false}") == {ReasonCode.SELF_COLLISION}
    assert codes("fixed", "{allow: [[floor, tip], [floor, middle], [floor, upper]]}") == {
        ReasonCode.SELF_COLLISION,
        ReasonCode.KEEP_OUT,
    }


def test_a_wall_has_the_distance_of_the_world(tmp_path: Path) -> None:
    bodies = CollisionModel(arm(tmp_path, "{world_m: 0.03}", support="fixed", world=WALL))
    found = {pair.bodies: pair.block for pair in bodies.pairs}
    assert found["wall", "tip"] == 0.03
    assert found["base", "tip"] == 0.002
    wall = [pair.bodies for pair in bodies.pairs].index(("wall", "tip"))
    assert bodies.distances(np.zeros((1, 3)))[0, wall] == bodies.reach


def test_a_model_whose_masks_let_nothing_collide_has_no_pairs(tmp_path: Path) -> None:
    robot = arm_file(tmp_path)
    xml = (tmp_path / "arm.xml").read_text()
    (tmp_path / "arm.xml").write_text(xml.replace("<geom ", '<geom contype="2" conaffinity="1" '))
    assert not candidates(bind(robot, None).model)


def test_a_height_field_of_the_world_must_be_allowed(tmp_path: Path) -> None:
    world = '<geom name="ground" type="hfield" hfield="ground"/>'
    robot = arm_file(tmp_path, support="fixed")
    xml = (tmp_path / "arm.xml").read_text()
    asset = '<asset><hfield name="ground" nrow="2" ncol="2" size="1 1 0.1 0.1"/></asset><worldbody>'
    (tmp_path / "arm.xml").write_text(xml.replace("<worldbody>", asset + world))
    with pytest.raises(InvalidInput, match="height field"):
        CollisionModel(bind(robot, None))


@pytest.mark.parametrize(
    "option",
    [
        '<flag contact="disable"/>',
        '<flag constraint="disable"/>',
        '<flag override="enable"/>',
        '<flag sleep="enable"/>',
        '<flag nativeccd="disable"/>',
    ],
)
def test_what_a_model_switches_off_for_its_simulation_hides_no_body(tmp_path: Path, option: str) -> None:
    folded = np.array([[0.0, 2.9, 0.1], [0.0, 2.5, 0.6], [0.5, 2.9, -1.0]])
    plain = CollisionModel(arm(tmp_path)).distances(folded)
    assert plain.min() < 0.0
    assert ((plain > 0.0) & (plain < 0.03)).any()
    xml = (tmp_path / "arm.xml").read_text().replace("<worldbody>", f"<option>{option}</option><worldbody>")
    (tmp_path / "arm.xml").write_text(xml)
    robot = read_robot(tmp_path / "arm.yaml")
    assert CollisionModel(bind(robot, None)).distances(folded) == pytest.approx(plain, abs=1e-9)


def test_contacts_that_a_models_memory_does_not_hold_count_as_touching(robot: Binding) -> None:
    hush()  # it would write a file of warnings
    small = robot.mjcf.replace("<worldbody>", '<size memory="20K"/><worldbody>', 1)
    bodies = CollisionModel(replace(robot, model=mujoco.MjModel.from_xml_string(small)), 0.1)
    places = poses(robot, 100, 1.0)
    wanted = CollisionModel(robot, 0.1).distances(places)
    found = bodies.distances(places)
    full = (found == -0.1).all(axis=1)
    assert 0 < np.count_nonzero(full) < 50
    assert found[~full] == pytest.approx(wanted[~full], abs=1e-9)


def test_a_coarse_search_for_contacts_makes_no_distance_longer(tmp_path: Path) -> None:
    poses = np.linspace([0.3, 2.2, -0.5], [0.3, 2.9, 1.5], 40)
    plain = CollisionModel(arm(tmp_path, tip="ellipsoid")).distances(poses)
    assert (plain < 0.03).any()
    coarse = '<option ccd_iterations="1" ccd_tolerance="0.1"/><worldbody>'
    xml = (tmp_path / "arm.xml").read_text().replace("<worldbody>", coarse)
    (tmp_path / "arm.xml").write_text(xml)
    robot = read_robot(tmp_path / "arm.yaml")
    assert CollisionModel(bind(robot, None)).distances(poses) == pytest.approx(plain, abs=1e-9)


def test_the_model_that_is_shared_stays_as_it_is(robot: Binding) -> None:
    before = robot.model.geom_margin.copy()
    CollisionModel(robot)
    assert np.array_equal(robot.model.geom_margin, before)
    assert not robot.model.geom_margin.any()
