"""A pinned robot touches itself exactly where the floating one does, in every model that is made of it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.support.examples import fast_cases
from tests.support.hull_robot import hull
from twind.config.robot_file import built_in_robots, load_robot
from twind.config.robot_spec import RobotFile
from twind.exceptions import InvalidInput
from twind.learn.task.plant_model import plant_of
from twind.robot.arrays import Floats
from twind.robot.finding import ReasonCode
from twind.robot.trajectory import Reference, Trajectory
from twind.twin.base_pose import UPRIGHT
from twind.twin.binding import Binding, bind
from twind.twin.clearance_survey import survey
from twind.twin.collision_model import CollisionModel, candidates
from twind.twin.mujoco_physics import MujocoPhysics, body_of
from twind.twin.pinning import pin
from twind.twin.trajectory_precheck import TrajectoryPrecheck

PAIR = '<contact><pair geom1="torso" geom2="head"/></contact>'
EXCLUDED = '<contact><exclude body1="torso" body2="head"/></contact>'
KEY = '<keyframe><key name="k" qpos="0 0 1 1 0 0 0 0 0 0 0"/></keyframe>'
HULLS: dict[str, dict[str, str]] = {
    "plain": {},
    "static bodies fused": {"compiler": 'fusestatic="true"'},
    "parent filter off": {"option": '<flag filterparent="disable"/>'},
    "a pair named by the model": {"more": PAIR},
    "a pair excluded by the model": {"more": EXCLUDED},
    "a key pose": {"more": KEY},
}
Gap = tuple[frozenset[str], float]
Robots = dict[str, RobotFile]


def held(robot: RobotFile, support: str) -> RobotFile:
    return replace(robot, support=support)


def poses(binding: Binding, count: int) -> Floats:
    random = np.random.default_rng(5)
    lower = binding.limits.lower
    upper = binding.limits.upper
    drawn = lower + random.random((count, len(lower))) * (upper - lower)
    found: Floats = np.vstack([binding.rest, drawn])
    return found


def gaps(model: mujoco.MjModel, qpos: list[int], position: Floats) -> list[Gap]:
    """Contacts in one pose: names of both geoms, distance in m; without those of the base and the world."""
    data = mujoco.MjData(model)
    data.qpos[qpos] = position
    mujoco.mj_kinematics(model, data)
    mujoco.mj_collision(model, data)
    still = {geom for geom in range(model.ngeom) if not _moves_alone(model, geom)}
    found = zip(data.contact.geom.tolist(), data.contact.dist.tolist(), strict=True)
    named = [
        (frozenset(model.geom(geom).name or f"geom {geom}" for geom in pair), distance)
        for pair, distance in found
        if not set(pair) <= still
    ]
    return sorted(named, key=lambda gap: (sorted(gap[0]), gap[1]))


def _moves_alone(model: mujoco.MjModel, geom: int) -> bool:
    """A hinge stands between this geom and the world."""
    body = int(model.geom_bodyid[geom])
    while body:
        first = model.body_jntadr[body]
        if first >= 0 and model.jnt_type[first] != mujoco.mjtJoint.mjJNT_FREE:
            return True
        body = int(model.body_parentid[body])
    return False


def alike(one: list[Gap], other: list[Gap]) -> bool:
    """Pairs are the same; distances too, within the rounding of a base that stands elsewhere in the world."""
    same = [pair for pair, _ in one] == [pair for pair, _ in other]
    return same and np.allclose([gap for _, gap in one], [gap for _, gap in other], atol=1e-7)


def virtual(robot: RobotFile, **more: str) -> MujocoPhysics:
    return body_of(robot, dict.fromkeys(robot.names, 2048), **more)  # type: ignore[arg-type]


def addresses(model: mujoco.MjModel, robot: RobotFile) -> list[int]:
    return [int(model.joint(joint.model_joint).qposadr[0]) for joint in robot.joints]


def mismatches(robot: RobotFile, made: Callable[[RobotFile], mujoco.MjModel], count: int = 60) -> list[str]:
    """Poses in which `made` of the robot on a gantry has other contacts than the floating binding."""
    floating = bind(held(robot, "free"), None)
    model = made(held(robot, "gantry"))
    there = addresses(model, robot)
    found = []
    touched = 0
    for pose in poses(floating, count):
        truth = gaps(floating.model, floating.qpos.tolist(), pose)
        touched += bool(truth)
        ours = gaps(model, there, pose)
        if not alike(ours, truth):
            found.append(f"{ours} instead of {truth}")
    assert touched
    return found


def bound_model(robot: RobotFile) -> mujoco.MjModel:
    return bind(robot, None).model


def written_model(robot: RobotFile) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(bind(robot, None).mjcf)


def virtual_model(robot: RobotFile) -> mujoco.MjModel:
    return virtual(robot).model


def lying_model(robot: RobotFile) -> mujoco.MjModel:
    """On its back: without the bench, which the floating model lacks."""
    model = virtual(robot, base="back").model
    model.geom_contype[model.geom("bench").id] = 0
    model.geom_conaffinity[model.geom("bench").id] = 0
    return model


MODELS = [bound_model, written_model, virtual_model, lying_model]
TOUCHING = [name for name in built_in_robots() if name != "pan-tilt"]  # whose bodies cannot reach each other


@pytest.mark.parametrize("made", MODELS)
@pytest.mark.parametrize("name", TOUCHING)
def test_a_built_in_robot_has_the_contacts_of_the_floating_one(
    name: str, made: Callable[[RobotFile], mujoco.MjModel]
) -> None:
    assert mismatches(load_robot(name), made) == []


@pytest.mark.parametrize("made", fast_cases(MODELS, {bound_model}))
@pytest.mark.parametrize("name", HULLS)
def test_a_robot_whose_hull_overlaps_its_limbs_has_the_contacts_of_the_floating_one(
    tmp_path: Path, name: str, made: Callable[[RobotFile], mujoco.MjModel]
) -> None:
    assert mismatches(hull(tmp_path, **HULLS[name]), made) == []


@pytest.mark.parametrize("support", ["gantry", "fixed"])
def test_a_hull_at_rest_touches_nothing(tmp_path: Path, support: str) -> None:
    binding = bind(hull(tmp_path, support=support), None)
    assert gaps(binding.model, binding.qpos.tolist(), binding.rest) == []


@pytest.mark.parametrize("compiler", ["", 'fusestatic="true"'])
def test_the_same_pairs_of_the_robot_are_judged(tmp_path: Path, compiler: str) -> None:
    robots = {
        support: hull(tmp_path / support, support=support, compiler=compiler)
        for support in ("free", "gantry", "fixed")
    }
    judged = {
        support: {frozenset(pair.bodies) for pair in CollisionModel(bind(robot, None)).pairs}
        for support, robot in robots.items()
    }
    assert judged["gantry"] == judged["free"]
    assert {pair for pair in judged["fixed"] if "floor" not in pair} == judged["free"]
    floor = {name for pair in judged["fixed"] if "floor" in pair for name in pair - {"floor"}}
    assert floor == {"tail", "head", "face", "body 6", "arm", "hand"}


def test_check_robot_finds_no_pair_and_proposes_none(tmp_path: Path) -> None:
    found = survey(bind(hull(tmp_path), None), {})
    assert found.near == ()
    assert found.proposed == ()
    assert found.judged > 5


def test_a_motion_is_accepted_without_a_warning(tmp_path: Path) -> None:
    binding = bind(hull(tmp_path), None)
    path = Trajectory(
        np.array([2.0]), np.array([[0.5, 0.0, 0.0, 0.0]]), np.array([True, False, False, False])
    )
    still = Reference(binding.rest, 0.0 * binding.rest, 0.0 * binding.rest)
    steps = TrajectoryPrecheck(binding, 0.01).judging(path, still)
    while True:
        try:
            next(steps)
        except StopIteration as stop:
            verdict = stop.value
            break
    assert ReasonCode.SELF_COLLISION not in {finding.code for finding in verdict.warnings}
    assert verdict.refusals == ()


def test_a_learner_lets_the_same_pairs_collide_as_the_pinned_robot(tmp_path: Path) -> None:
    """The learner's robot floats. Servo bodies collide here, so that limbs overlap the torso."""
    robot = solid(tmp_path)
    pinned = bind(robot, None).model
    learnt = plant_of(robot, period=0.02, looks=True).model
    names = {geom: learnt.geom(geom).name or f"geom {geom}" for geom in range(learnt.ngeom)}
    assert names == {geom: pinned.geom(geom).name or f"geom {geom}" for geom in range(pinned.ngeom)}
    world = {geom for geom in range(pinned.ngeom) if pinned.geom_bodyid[geom] == 0}
    ours, theirs = (
        {pair for pair in candidates(model) if not world & set(pair)} for model in (pinned, learnt)
    )
    assert ours == theirs


def solid(folder: Path) -> RobotFile:
    """The h24, but that its servo bodies collide."""
    robot = load_robot("h24")
    text = robot.mjcf.replace('contype="0" conaffinity="0"', "")
    assert text != robot.mjcf
    path = folder / "solid.xml"
    path.write_text(text)
    return replace(robot, mjcf_path=path, mjcf=text)


def test_a_humanoid_of_solid_servos_has_the_contacts_of_the_floating_one(tmp_path: Path) -> None:
    assert mismatches(solid(tmp_path), bound_model, 20) == []


# ------------------------------------------------------------------------------------------ other bases


def test_a_base_that_the_model_itself_fastens_is_left_as_it_is(tmp_path: Path) -> None:
    robot = hull(tmp_path)
    text = robot.mjcf.replace("<freejoint/>", "").replace(
        '<body name="torso" pos="0 0 0.6">', '<body name="stand" pos="0 0 0.6"><body name="torso">'
    )
    end = "</body>\n  </worldbody>"
    (tmp_path / "hull.xml").write_text(text.replace(end, f"</body>{end}"))
    model = bind(robot, None).model
    theirs = mujoco.MjModel.from_xml_path(str(tmp_path / "hull.xml"))
    assert model.nexclude == theirs.nexclude == 0
    rest = np.zeros(4)
    assert gaps(model, [0, 1, 2, 3], rest) == gaps(theirs, [0, 1, 2, 3], rest) != []


def test_a_base_that_is_carried_by_a_floating_body_is_refused_and_pinned_with_it(tmp_path: Path) -> None:
    robot = hull(tmp_path)
    carried = '<body name="root" pos="0 0 0.6"><freejoint name="root"/><body name="torso">'
    text = robot.mjcf.replace('<body name="torso" pos="0 0 0.6">', carried).replace("<freejoint/>", "")
    end = "</body>\n  </worldbody>"
    text = text.replace(end, f"</body>{end}")
    text = text.replace("<body>", '<body name="nose">')
    (tmp_path / "hull.xml").write_text(text)
    with pytest.raises(InvalidInput, match="'root' stands neither in `joints` nor in `passive`"):
        bind(robot, None)
    floating = mujoco.MjModel.from_xml_string(text)
    spec = mujoco.MjSpec.from_string(text)
    pin(spec, spec.body("root"))
    pinned = spec.compile()
    for pose in np.random.default_rng(2).uniform(-1.9, 1.9, (30, 4)):
        truth = gaps(floating, addresses(floating, robot), pose)
        assert alike(gaps(pinned, addresses(pinned, robot), pose), truth)


def test_an_unnamed_body_gets_a_name_that_no_other_has(tmp_path: Path) -> None:
    robot = hull(tmp_path)
    number = bind(held(robot, "free"), None).model.geom("nose").bodyid[0]
    taken = robot.mjcf.replace('<body name="tail"', f'<body name="body {number}"')
    (tmp_path / "hull.xml").write_text(taken)
    model = bind(robot, None).model
    assert model.body(model.geom("nose").bodyid[0]).name == f"body {number}'"
    assert gaps(model, [0, 1, 2, 3], np.zeros(4)) == []


def test_a_virtual_robot_on_a_gantry_stays_upright_where_it_is_put(tmp_path: Path) -> None:
    body = virtual(hull(tmp_path), base=UPRIGHT)
    body.advance(1.0)
    assert body.data.xpos[body.model.body("torso").id] == pytest.approx([0.0, 0.0, 0.6])
    assert body.data.ncon == 0
