"""Identification of the moved servo by its own load and by that of the others. Pure, on models' loads."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.proof_rig import ANY, BASES, FRICTION, H24, PLACES, body, measured_by, place
from twind.config.robot_file import load_robot
from twind.config.robot_spec import RobotFile
from twind_calibration.proving.expected_loads import at_places, strained
from twind_calibration.proving.load_comparison import LoadComparisonResult, weigh
from twind_calibration.proving.sign_proof import ContradictionKind, SignProofStatus
from twind_calibration.wiggling.posed_model import PosedModel

MIRRORED = re.compile(r"r_(\w+_pitch|knee|elbow)")
PITCHES = re.compile(r'(<joint name="r_(?:\w+_pitch|knee|elbow)" axis="0 )1( 0" range=")(\S+) (\S+)"')


@pytest.fixture(scope="module")
def mirrored(tmp_path_factory: pytest.TempPathFactory) -> RobotFile:
    """The h24 with the pitch axes of its right side pointing right: a pose is the same angles negated."""
    folder = tmp_path_factory.mktemp("mirrored")
    source = H24.path.parent
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


def matched(
    robot: RobotFile,
    base: str,
    name: str,
    *,
    other: str | None = None,
    size: float = 0.25,
    friction: float = FRICTION,
    pose: dict[str, float] | None = None,
) -> LoadComparisonResult:
    """Comparison for a joint whose servo has the place of `other`; None: its own."""
    one = PosedModel(robot, base)
    joint = robot.names.index(name)
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
        found = matched(robot, "back", f"l_{name}", other=f"r_{name}")
        assert (found.judged.proof, found.judged.against) == (
            SignProofStatus.CONTRADICTED,
            ContradictionKind.SIGN,
        )
        assert robot.names.index(f"r_{name}") in found.like
        right = matched(robot, "back", f"l_{name}")
        assert right.judged.proof is SignProofStatus.PROVED and not right.like


def test_twins_with_parallel_axes_are_distinguished_only_by_the_loads_of_attached_links() -> None:
    """All servos the same way round: only the shanks feel which leg was moved, where friction lets them."""
    alike = replace(H24, joints=tuple(replace(joint, sign=1) for joint in H24.joints))
    right = alike.names.index("r_hip_pitch")
    found = matched(alike, "back", "l_hip_pitch", other="r_hip_pitch")
    assert found.judged.proof is SignProofStatus.PROVED  # its sign is right, whoever it is
    assert right in found.untold
    far = {"size": 0.7, "friction": 0.03}
    told = matched(alike, "upright", "l_hip_pitch", other="r_hip_pitch", **far)
    assert (told.judged.proof, told.judged.against) == (SignProofStatus.CONTRADICTED, ContradictionKind.PLACE)
    assert right in told.like
    assert right not in matched(alike, "upright", "l_hip_pitch", **far).untold


@pytest.mark.parametrize(
    ("base", "name", "other"),
    [
        ("back", "l_hip_roll", "l_hip_pitch"),
        ("back", "l_hip_pitch", "l_shoulder_pitch"),
        ("left", "l_knee", "l_hip_roll"),
    ],
)
def test_an_exchanged_servo_is_named_where_few_joints_have_such_loads(
    base: str, name: str, other: str
) -> None:
    found = matched(H24, base, name, other=other)
    assert found.judged.proof is SignProofStatus.CONTRADICTED
    assert place(other) in found.like


@given(st.sampled_from(BASES), ANY, st.sampled_from(H24.names))
@examples(15)
def test_exchanged_servos_are_contradicted_or_undecided_never_excluded(
    base: str, name: str, other: str
) -> None:
    if place(other) not in body().twins(place(name)):
        return
    found = matched(H24, base, name, other=other)
    assert found.judged.proof is SignProofStatus.CONTRADICTED or place(other) in found.untold


def test_an_adjacent_joint_with_the_wrong_sign_is_named() -> None:
    """The forearm is bent where the model believes it is bent the other way."""
    one = PosedModel(H24, "left")
    joint = place("l_hip_yaw")
    elbow = place("l_hip_pitch")
    start = np.zeros(len(H24.names))
    start[elbow] = -0.6
    poses = at_places(start, joint, PLACES)
    loads = np.array([one.flipped(each, elbow) for each in poses])
    found = weigh(one, joint, measured_by(loads, poses), FRICTION)
    assert found.judged.proof is SignProofStatus.CONTRADICTED
    assert found.bent == (elbow,)


def test_upright_the_waist_feels_a_hip_that_goes_the_wrong_way_and_the_hip_itself_does_not() -> None:
    one = PosedModel(H24)
    joint = place("l_hip_pitch")
    poses = at_places(np.zeros(len(H24.names)), joint, PLACES)
    loads = np.array([one.flipped(each, joint) for each in poses])
    found = weigh(one, joint, measured_by(loads, poses), FRICTION)
    assert (found.judged.proof, found.judged.against) == (
        SignProofStatus.CONTRADICTED,
        ContradictionKind.OTHERS,
    )
    assert found.judged.misfit < 0.01, "its own load fits"
    loads[:, place("waist_pitch")] = 0.0  # propped
    alone = weigh(one, joint, measured_by(loads, poses), FRICTION)
    assert alone.judged.proof is SignProofStatus.UNOBSERVABLE


def test_a_supported_joint_proves_no_exchange() -> None:
    """Its load does not change, whoever is moved: that is no sign of an exchanged servo."""
    one = PosedModel(H24, "left")
    joint = place("waist_yaw")
    poses = at_places(np.zeros(len(H24.names)), joint, PLACES)
    loads = np.array([one.torque(each) for each in poses])
    assert np.ptp(loads[:, place("waist_pitch")]) > 1.0
    loads[:, place("waist_pitch")] = 0.0
    found = weigh(one, joint, measured_by(loads, poses), FRICTION)
    assert (found.judged.proof, found.like) == (SignProofStatus.UNOBSERVABLE, ())


def test_a_joint_on_the_ground_or_without_readings_is_unobservable() -> None:
    free = replace(H24, support="free")
    assert matched(free, "upright", "l_hip_pitch").judged.proof is SignProofStatus.UNOBSERVABLE
    assert matched(free, "back", "l_hip_pitch").judged.proof is SignProofStatus.PROVED
    one = PosedModel(H24, "back")
    joint = place("l_hip_pitch")
    poses = at_places(np.zeros(len(H24.names)), joint, PLACES)
    loads = np.array([one.torque(each) for each in poses])
    unheard = poses.copy()
    unheard[0, 0] = np.nan
    found = weigh(one, joint, measured_by(loads, unheard), FRICTION)
    assert found.judged.proof is SignProofStatus.UNOBSERVABLE


def test_a_joint_that_holds_much_is_named_with_what_it_holds() -> None:
    nothing = np.zeros(len(H24.names))
    assert strained(PosedModel(H24), nothing) == {}
    assert list(strained(PosedModel(H24, "back"), nothing).values()) == [
        "waist_pitch holds 3.9 of its 4.1 N·m"
    ]


def test_the_mirrored_robot_is_one(mirrored: RobotFile) -> None:
    """The fixture: the same pose in space, angles of the right side's pitch joints negated."""
    pose = np.array([0.1 * (place + 1) % 0.5 for place in range(len(H24.names))])
    flip = np.array([-1.0 if MIRRORED.fullmatch(name) else 1.0 for name in H24.names])
    assert PosedModel(mirrored).torque(flip * pose) == pytest.approx(
        flip * PosedModel(H24).torque(pose), abs=1e-9
    )
    assert Path(mirrored.mjcf_path).parent != H24.path.parent
