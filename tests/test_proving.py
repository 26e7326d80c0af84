"""What gravity proves of a joint's sign, place and zero, and what it cannot: pure, on the loads of models."""

import re
from dataclasses import replace
from functools import cache
from math import radians
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from twind.config.robot_file import load_robot
from twind.config.robot_spec import RobotFile
from twind.robot.arrays import Floats
from twind_calibration.proving.expected import Expected, look_ahead, strained
from twind_calibration.proving.expected import swept as at_places
from twind_calibration.proving.judge import GROSS, Against, Judged, Proof, apart, judge, misfits, slack
from twind_calibration.proving.sweep import LEAST, OVER, Swept, sweeps, swept
from twind_calibration.proving.weighed import Weighed, weigh
from twind_calibration.wiggling.body import Body
from twind_calibration.wiggling.trace import Stay, Stays

H24 = load_robot("h24")
LSB, FRICTION = 0.0048, 0.1  # N·m
PLACES = np.linspace(-0.25, 0.25, 4)  # rad, around the pose
MIRRORED = re.compile(r"r_(\w+_pitch|knee|elbow)")
BASES = ("upright", "back", "left")
PITCHES = re.compile(r'(<joint name="r_(?:\w+_pitch|knee|elbow)" axis="0 )1( 0" range=")(\S+) (\S+)"')


@cache
def body() -> Body:
    return Body(H24)


def place(name: str) -> int:
    return H24.names.index(name)


@pytest.fixture(scope="module")
def mirrored(tmp_path_factory: pytest.TempPathFactory) -> RobotFile:
    """The h24 with the pitch axes of its right side pointing right: a pose is the same angles negated."""
    folder, source = tmp_path_factory.mktemp("mirrored"), H24.path.parent
    model = PITCHES.sub(
        lambda f: f'{f[1]}-1{f[2]}{-float(f[4]):g} {-float(f[3]):g}"', (source / "h24.xml").read_text()
    )
    (folder / "h24.xml").write_text(model)
    told = yaml.safe_load((source / "h24.yaml").read_text())
    for name, joint in told["joints"].items():
        joint.pop("sign", None)
        joint.pop("stop_rad", None)
        if MIRRORED.fullmatch(name):
            joint["limits_rad"] = [-end for end in joint["limits_rad"][::-1]]
    for pose in told["poses"].values():
        pose.update({name: -angle for name, angle in pose.items() if MIRRORED.fullmatch(name)})
    (folder / "mirrored.yaml").write_text(yaml.safe_dump(told, sort_keys=False))
    return load_robot(str(folder / "mirrored.yaml"))


# ------------------------------------------------------------------------------------- one joint's load


def judged(
    base: str,
    name: str,
    *,
    wrong: bool = False,
    off: float = 0.0,
    stretch: float = 1.0,
    rubs: float = 0.05,
    noise: Floats | None = None,
    pose: Floats | None = None,
) -> Judged:
    """A joint whose zero is `off` (rad) and whose servo tells `stretch` of its torque, less friction."""
    one, joint = body(), place(name)
    one.lie(base)
    poses = at_places(np.zeros(len(H24.names)) if pose is None else pose, joint, PLACES)
    true = poses.copy()
    true[:, joint] += off
    if wrong:
        loads = np.array([one.flipped(each, joint)[joint] for each in true])
    else:
        loads = np.array([one.torque(each)[joint] for each in true])
    rough = np.zeros(len(PLACES)) if noise is None else 0.98 * slack(FRICTION, LSB) * noise
    told, expected = stretch * loads + rough, Expected(one, poses, joint)
    return judge(told + rubs, told - rubs, expected.right(), expected.reversed(), FRICTION, LSB)


ANY = st.sampled_from([name for name in H24.names if not name.startswith("r_")])
NOISE = st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4).map(np.array)
TORQUE = st.floats(0.61, 1.39)


@given(st.sampled_from(BASES), ANY, st.floats(-0.95, 0.95), TORQUE, st.floats(0.0, 0.1), NOISE)
def test_a_joint_that_is_right_is_never_contradicted(
    base: str, name: str, off: float, stretch: float, rubs: float, noise: Floats
) -> None:
    """Whatever its torque per ampere, friction left and rounding; its zero off by less than 5 degrees."""
    found = judged(base, name, off=off * GROSS, stretch=stretch, rubs=rubs, noise=noise)
    assert found.proof is not Proof.CONTRADICTED
    assert (found.proof is Proof.PROVED) == found.foreseen.observable
    if np.isfinite(found.offset):
        assert abs(found.offset - off * GROSS) <= found.offset_unsure + 1e-9


@given(st.sampled_from(BASES), ANY, st.floats(-0.95, 0.95), TORQUE, st.floats(0.0, 0.1), NOISE)
def test_a_wrong_sign_is_never_proved_nor_plausible_and_is_caught_where_the_model_says_so(
    base: str, name: str, off: float, stretch: float, rubs: float, noise: Floats
) -> None:
    found = judged(base, name, wrong=True, off=off * GROSS, stretch=stretch, rubs=rubs, noise=noise)
    assert found.proof in (Proof.UNOBSERVABLE, Proof.CONTRADICTED)
    if found.foreseen.observable:
        assert (found.proof, found.against) == (Proof.CONTRADICTED, Against.SIGN)
        assert found.slope_ratio < 0.0


@pytest.mark.parametrize("name", ["l_hip_pitch", "l_hip_roll", "l_knee"])
def test_upright_a_wrong_sign_regresses_with_slope_one_and_is_no_pass(name: str) -> None:
    found = judged("upright", name, wrong=True)
    assert found.proof is Proof.UNOBSERVABLE
    assert found.slope_ratio == pytest.approx(1.0, abs=0.02)
    assert found.foreseen.span > 0.2 and found.foreseen.flip < 0.01


@pytest.mark.parametrize(
    ("base", "name", "observable"),
    [
        ("back", "l_hip_pitch", True),
        ("back", "l_knee", True),
        ("back", "l_shoulder_pitch", True),
        ("back", "l_hip_roll", False),
        ("left", "l_hip_roll", True),
        ("left", "l_shoulder_roll", True),
        ("left", "l_hip_pitch", False),
        ("upright", "l_hip_pitch", False),
        ("back", "l_ankle_pitch", False),  # less than friction, whatever the pose
        ("back", "l_elbow", False),
    ],
)
def test_which_base_pose_shows_a_sign_is_known_before_anything_moves(
    base: str, name: str, observable: bool
) -> None:
    body().lie(base)
    ahead = look_ahead(body(), np.zeros(len(H24.names)), place(name), PLACES, FRICTION)
    assert ahead.observable is observable
    found = judged(base, name)
    assert (found.proof is Proof.PROVED) is observable
    assert found.foreseen.flip == pytest.approx(ahead.flip, abs=0.01)


def test_more_friction_than_reckoned_with_makes_a_sign_unobservable() -> None:
    assert judged("back", "l_shoulder_pitch", rubs=0.05).proof is Proof.PROVED
    rough = judged("back", "l_shoulder_pitch", rubs=0.6)
    assert rough.friction == pytest.approx(0.6)
    assert rough.proof is Proof.UNOBSERVABLE


def test_evidence_that_is_no_proof_is_called_plausible() -> None:
    """The elbow on its back: 0.15 N·m between the signs, less where torque per ampere is 40 % less."""
    assert judged("back", "l_elbow").proof is Proof.PLAUSIBLE
    assert judged("back", "l_elbow", wrong=True).proof is Proof.CONTRADICTED
    assert judged("back", "l_ankle_pitch").proof is Proof.UNOBSERVABLE


def test_a_load_that_fits_both_signs_is_unobservable_though_a_better_one_would_have_told() -> None:
    """An elbow that tells next to nothing: 0.6 of its load, and that of the other sign, are as near."""
    one, joint = body(), place("l_elbow")
    one.lie("back")
    expected, nothing = Expected(one, at_places(np.zeros(24), joint, PLACES), joint), np.zeros(4)
    found = judge(nothing, nothing, expected.right(), expected.reversed(), FRICTION, LSB)
    assert found.foreseen.visible and not found.foreseen.observable
    assert found.proof is Proof.UNOBSERVABLE


@pytest.mark.parametrize("off", [-0.4, -0.2, 0.2, 0.4])
def test_a_zero_that_is_grossly_off_contradicts_where_the_span_tells(off: float) -> None:
    found = judged("upright", "l_hip_pitch", off=off)
    assert (found.proof, found.against) == (Proof.CONTRADICTED, Against.ZERO)
    assert abs(found.offset - off) <= found.offset_unsure
    small = judged("upright", "l_hip_pitch", off=0.03)
    assert small.against is Against.NOTHING
    assert abs(small.offset - 0.03) <= small.offset_unsure < 0.1


def test_torque_that_is_told_the_wrong_way_round_is_called_so() -> None:
    """A reverse bit that turns position and not current: slope -1 where everything hangs."""
    one, joint = body(), place("l_hip_pitch")
    one.lie("upright")
    expected = Expected(one, at_places(np.zeros(len(H24.names)), joint, PLACES), joint)
    loads = -np.array([one.torque(pose)[joint] for pose in at_places(np.zeros(24), joint, PLACES)])
    found = judge(loads, loads, expected.right(), expected.reversed(), FRICTION, LSB)
    assert (found.proof, found.against) == (Proof.CONTRADICTED, Against.CURRENT)
    assert found.slope_ratio == pytest.approx(-1.0, abs=0.02)


@pytest.mark.parametrize("stretch", [0.2, 2.5])
def test_another_ratio_or_mass_is_no_right_sign(stretch: float) -> None:
    found = judged("back", "l_hip_pitch", stretch=stretch)
    assert (found.proof, found.against) == (Proof.CONTRADICTED, Against.NEITHER)


@pytest.mark.parametrize("where", [0, 3])
def test_a_load_that_is_no_number_proves_nothing(where: int) -> None:
    noise = np.zeros(4)
    noise[where] = np.nan
    assert judged("back", "l_hip_pitch", noise=noise).proof is Proof.UNOBSERVABLE


ROWS = st.lists(st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3), min_size=1, max_size=4).map(np.array)


@given(ROWS, ROWS, st.floats(0.6, 1.4), st.floats(0.6, 1.4), st.data())
def test_no_load_is_nearer_to_both_families_than_half_of_what_lies_between_them(
    one: Floats, other: Floats, s: float, t: float, data: st.DataObject
) -> None:
    between = apart(one, other)
    first, second = data.draw(st.sampled_from(list(one))), data.draw(st.sampled_from(list(other)))
    assert np.sqrt(((s * first - t * second) ** 2).mean()) >= between - 1e-6
    measured = (s * first + t * second) / 2.0
    near = max(misfits(measured, one).min(), misfits(measured, other).min())
    assert near >= between / 2.0 - 1e-6
    assert apart(other, one) == pytest.approx(between, abs=1e-6)
    assert apart(one, one) < 1e-6


def test_a_joint_that_tells_no_torque_unit_still_has_its_friction() -> None:
    assert slack(0.1, float("nan")) == pytest.approx(0.05)
    assert slack(0.1, 0.01) == pytest.approx(0.06)


# ------------------------------------------------------------------------------------- whose servo it is


def measured_by(loads: Floats, poses: Floats) -> Swept:
    """Told loads (k, n) at told poses (k, n)."""
    nothing = Stay(poses[0], poses[0], loads[0])
    rubs = np.full_like(loads, 0.04)
    return Swept(poses, loads, loads + rubs, loads - rubs, Stays(nothing, nothing, nothing))


def weighed(
    robot: RobotFile,
    base: str,
    name: str,
    *,
    other: str | None = None,
    size: float = 0.25,
    friction: float = FRICTION,
    pose: dict[str, float] | None = None,
) -> Weighed:
    """Of a joint whose servo has the place of `other`; None: its own."""
    one, joint = Body(robot, base), robot.names.index(name)
    start = np.array([(pose or {}).get(each, 0.0) for each in robot.names])
    poses = at_places(start, joint, start[joint] + np.linspace(-size, size, 4))
    if other is None:
        loads = np.array([one.torque(each) for each in poses])
    else:
        loads = np.array([one.exchanged(each, joint, robot.names.index(other)) for each in poses])
    return weigh(one, joint, measured_by(loads, poses), friction)


@pytest.mark.parametrize("kind", ["h24", "mirrored"])
def test_after_a_failed_sign_proof_the_twin_is_named_before_the_sign_is_touched(
    kind: str, mirrored: RobotFile
) -> None:
    """Left and right exchanged look like a wrong sign, by mirrored servos or mirrored axes alike."""
    robot = H24 if kind == "h24" else mirrored
    assert len({joint.sign for joint in robot.joints}) == (2 if kind == "h24" else 1)
    for name in ("hip_pitch", "shoulder_pitch"):
        found = weighed(robot, "back", f"l_{name}", other=f"r_{name}")
        assert (found.judged.proof, found.judged.against) == (Proof.CONTRADICTED, Against.SIGN)
        assert robot.names.index(f"r_{name}") in found.like
        right = weighed(robot, "back", f"l_{name}")
        assert right.judged.proof is Proof.PROVED and not right.like


def test_twins_with_parallel_axes_are_untold_by_their_own_load_and_told_by_what_hangs_from_them() -> None:
    """All servos the same way round: only the shanks feel which leg was moved, where friction lets them."""
    alike = replace(H24, joints=tuple(replace(joint, sign=1) for joint in H24.joints))
    right = alike.names.index("r_hip_pitch")
    found = weighed(alike, "back", "l_hip_pitch", other="r_hip_pitch")
    assert found.judged.proof is Proof.PROVED  # its sign is right, whoever it is
    assert right in found.untold
    far = {"size": 0.7, "friction": 0.03}
    told = weighed(alike, "upright", "l_hip_pitch", other="r_hip_pitch", **far)
    assert (told.judged.proof, told.judged.against) == (Proof.CONTRADICTED, Against.PLACE)
    assert right in told.like
    assert right not in weighed(alike, "upright", "l_hip_pitch", **far).untold


@pytest.mark.parametrize(
    ("base", "name", "other"),
    [
        ("back", "l_hip_roll", "l_hip_pitch"),
        ("back", "l_hip_pitch", "l_shoulder_pitch"),
        ("left", "l_knee", "l_hip_roll"),
    ],
)
def test_whose_servo_is_here_is_named_where_few_measure_so_much(base: str, name: str, other: str) -> None:
    found = weighed(H24, base, name, other=other)
    assert found.judged.proof is Proof.CONTRADICTED
    assert place(other) in found.like


@given(st.sampled_from(BASES), ANY, st.sampled_from(H24.names))
@settings(max_examples=15)
def test_exchanged_servos_are_contradicted_or_left_untold_never_excluded(
    base: str, name: str, other: str
) -> None:
    if place(other) not in body().twins(place(name)):
        return
    found = weighed(H24, base, name, other=other)
    assert found.judged.proof is Proof.CONTRADICTED or place(other) in found.untold


def test_a_neighbour_with_the_wrong_sign_is_named() -> None:
    """The forearm is bent where the model believes it is bent the other way."""
    one, joint, elbow = Body(H24, "left"), place("l_hip_yaw"), place("l_hip_pitch")
    start = np.zeros(len(H24.names))
    start[elbow] = -0.6
    poses = at_places(start, joint, PLACES)
    loads = np.array([one.flipped(each, elbow) for each in poses])
    found = weigh(one, joint, measured_by(loads, poses), FRICTION)
    assert found.judged.proof is Proof.CONTRADICTED
    assert found.bent == (elbow,)


def test_upright_the_waist_feels_a_hip_that_goes_the_wrong_way_and_the_hip_itself_does_not() -> None:
    one, joint = Body(H24), place("l_hip_pitch")
    poses = at_places(np.zeros(len(H24.names)), joint, PLACES)
    loads = np.array([one.flipped(each, joint) for each in poses])
    found = weigh(one, joint, measured_by(loads, poses), FRICTION)
    assert (found.judged.proof, found.judged.against) == (Proof.CONTRADICTED, Against.OTHERS)
    assert found.judged.misfit < 0.01, "its own load fits"
    loads[:, place("waist_pitch")] = 0.0  # propped
    alone = weigh(one, joint, measured_by(loads, poses), FRICTION)
    assert alone.judged.proof is Proof.UNOBSERVABLE


def test_a_propped_joint_is_no_witness() -> None:
    """Its load does not change, whoever is moved: that is no sign of an exchanged servo."""
    one, joint = Body(H24, "left"), place("waist_yaw")
    poses = at_places(np.zeros(len(H24.names)), joint, PLACES)
    loads = np.array([one.torque(each) for each in poses])
    assert np.ptp(loads[:, place("waist_pitch")]) > 1.0
    loads[:, place("waist_pitch")] = 0.0
    found = weigh(one, joint, measured_by(loads, poses), FRICTION)
    assert (found.judged.proof, found.like) == (Proof.UNOBSERVABLE, ())


def test_what_the_ground_carries_or_nobody_heard_proves_nothing() -> None:
    free = replace(H24, support="free")
    assert weighed(free, "upright", "l_knee").judged.proof is Proof.UNOBSERVABLE
    assert weighed(free, "back", "l_knee").judged.proof is Proof.PROVED
    one, joint = Body(H24, "back"), place("l_knee")
    poses = at_places(np.zeros(len(H24.names)), joint, PLACES)
    loads = np.array([one.torque(each) for each in poses])
    unheard = poses.copy()
    unheard[0, 0] = np.nan
    found = weigh(one, joint, measured_by(loads, unheard), FRICTION)
    assert found.judged.proof is Proof.UNOBSERVABLE


def test_a_joint_that_holds_much_is_named_with_what_it_holds() -> None:
    nothing = np.zeros(len(H24.names))
    assert strained(Body(H24), nothing) == {}
    assert list(strained(Body(H24, "back"), nothing).values()) == ["waist_pitch holds 3.9 of its 4.1 N·m"]


# ------------------------------------------------------------------------------------- the way

ANGLES = st.floats(-2.0, 2.0)


@given(ANGLES, ANGLES, ANGLES, st.floats(radians(3), radians(45)))
def test_every_place_is_come_to_from_both_sides_and_inside_the_limits(
    a: float, b: float, home: float, size: float
) -> None:
    lower, upper = min(a, b), max(a, b)
    for way in sweeps(home, lower, upper, size):
        visits = np.array(way.visits)
        assert visits[0] == home and abs(visits[-1] - home) < 1e-3
        inside = visits[1:-1]
        assert (inside >= lower).all() and (inside <= upper).all()
        assert np.ptp(way.places) >= LEAST - 1e-9
        for at in way.places:
            came = {np.sign(at - visits[k - 1]) for k in range(1, len(visits)) if visits[k] == at}
            assert {1.0, -1.0} <= came
        assert abs(way.farthest) == pytest.approx(np.abs(visits - home).max())
        assert np.abs(way.places - home).max() <= 2.0 * size + 1e-9 or not lower <= home <= upper


def test_a_joint_without_room_has_no_way() -> None:
    assert sweeps(0.0, -0.05, 0.05, 0.2) == []
    assert [way.places[0] for way in sweeps(0.0, -0.1, 2.0, 0.2)] == pytest.approx([-0.06, 0.0, -0.06])


def test_the_means_are_of_both_directions() -> None:
    way = sweeps(0.1, -1.0, 1.0, 0.2)[0]
    stays = [
        Stay(np.array([at]), np.array([at]), np.array([10.0 * at + (1.0 if up else -1.0)]))
        for up, at in zip([True] * 6 + [False] * 6, way.visits, strict=True)
    ]
    shown = swept(way, stays)
    assert shown.poses[:, 0] == pytest.approx(way.places)
    assert shown.effort[:, 0] == pytest.approx(10.0 * way.places)
    assert (shown.up - shown.down)[:, 0] == pytest.approx(2.0)
    assert shown.ends.out.position[0] == pytest.approx(0.1 + way.farthest)
    assert way.farthest == pytest.approx(0.2 + OVER) or way.farthest == pytest.approx(-0.2 - OVER)


def test_the_mirrored_robot_is_one(mirrored: RobotFile) -> None:
    """The fixture: the same pose in space, angles of the right side's pitch joints negated."""
    pose = np.array([0.1 * (place + 1) % 0.5 for place in range(len(H24.names))])
    flip = np.array([-1.0 if MIRRORED.fullmatch(name) else 1.0 for name in H24.names])
    assert Body(mirrored).torque(flip * pose) == pytest.approx(flip * Body(H24).torque(pose), abs=1e-9)
    assert Path(mirrored.mjcf_path).parent != H24.path.parent
