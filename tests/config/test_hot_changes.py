"""Keys that change while the daemon runs: limits shrink, rules get stricter, others wait for a restart."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.doc_pages_text import ROOT, table
from tests.support.reload_rig import files, reread_of
from twind.config import hot_changes, reload_plan
from twind.config.config_files import describe, pack, unpacked
from twind.config.hot_changes import HOT, applied, robot_difference, same
from twind.config.hot_keys import BLOCK, LEVEL, OF_SETTINGS, PROOF, WARN
from twind.config.robot_file import load_robot
from twind.config.robot_spec import RobotFile
from twind.config.yaml_tree import ConfigError
from twind.exceptions import InvalidInput

H24 = load_robot("h24")
MIXED = load_robot("h24-mixed")
YAW = "joints.head_yaw"
LOWER = H24.joints[0].lower
UPPER = H24.joints[0].upper
assert H24.joints[0].name == "head_yaw"


def changed(robot: RobotFile, joint: int = 0, **fields: Any) -> RobotFile:
    joints = list(robot.joints)
    joints[joint] = replace(joints[joint], **fields)
    return replace(robot, joints=tuple(joints))


def gained(robot: RobotFile, **gains: Any) -> RobotFile:
    """The first joint's type with other gains, of every joint that has it."""
    kind = robot.joints[0].type
    other = replace(kind, gains=replace(kind.gains, **gains))  # type: ignore[attr-defined, call-arg]
    joints = tuple(replace(j, type=other if j.type.name == kind.name else j.type) for j in robot.joints)
    return replace(robot, joints=joints)


# ------------------------------------------------------------------------------------------- the rules


def test_a_wider_follow_bound_waits_for_a_restart() -> None:
    own = robot_difference(H24, changed(H24, own_follow_rad=0.4))
    assert (own.changes, own.restart) == ({}, (f"{YAW}.follow_rad",))
    kind = replace(H24.joints[0].type, follow_s=0.3)
    of_type = replace(H24, joints=tuple(replace(joint, type=kind) for joint in H24.joints))
    assert robot_difference(H24, of_type).restart == (f"types.{kind.name}.follow_s",)


def test_a_robot_read_twice_differs_in_nothing_unknown_numbers_included() -> None:
    kind = H24.joints[0].type
    one, other = (
        replace(H24, joints=tuple(replace(j, type=replace(kind, current_limit_a=nan)) for j in H24.joints))  # type: ignore[call-arg]
        for nan in (math.nan, float("nan"))
    )
    assert robot_difference(one, other).restart == ()
    for robot in ("h24", "h24-mixed", "h24-split"):
        found = robot_difference(load_robot(robot), load_robot(robot))
        assert (found.changes, found.restart) == ({}, ())


def test_unknown_is_the_same_as_unknown_and_as_nothing_else() -> None:
    assert same(math.nan, float("nan"))
    assert not same(math.nan, 0.0)
    assert same((1, {"a": math.nan}), (1, {"a": float("nan")}))
    assert not same((1,), (1, 2))
    assert not same({"a": 1}, {"b": 1})


def test_limits_that_shrink_are_hot_and_limits_that_widen_wait() -> None:
    narrower = robot_difference(H24, changed(H24, lower=LOWER + 0.1))
    assert narrower.changes == {f"{YAW}.limits_rad": [LOWER + 0.1, UPPER]}
    assert narrower.restart == ()
    for wider in (
        {"lower": LOWER - 0.1},
        {"upper": UPPER + 0.1},
        {"lower": LOWER + 0.1, "upper": UPPER + 0.1},
    ):
        found = robot_difference(H24, changed(H24, **wider))
        assert (found.changes, found.restart) == ({}, (f"{YAW}.limits_rad",)), wider


@pytest.mark.parametrize("what", ["velocity_limit", "acceleration_limit"])
def test_speed_and_acceleration_only_shrink(what: str) -> None:
    now = getattr(H24.joints[0], what)
    slower = robot_difference(H24, changed(H24, **{what: now * 0.5}))
    assert slower.changes == {f"{YAW}.{what}_{'rad_s' if what[0] == 'v' else 'rad_s2'}": now * 0.5}
    faster = robot_difference(H24, changed(H24, **{what: now * 1.5}))
    assert faster.changes == {}
    assert len(faster.restart) == 1


def test_a_limit_that_leaves_a_pose_outside_waits_for_its_pose() -> None:
    pose = H24.poses["rest"]["head_yaw"]
    found = robot_difference(H24, changed(H24, lower=pose + 0.01))
    assert (found.changes, found.restart) == ({}, (f"{YAW}.limits_rad",))


def test_gains_are_hot_and_whatever_else_a_type_has_is_not() -> None:
    name = H24.joints[0].type.name
    found = robot_difference(H24, gained(H24, p=123))
    assert list(found.changes) == [f"types.{name}.gains"]
    assert found.changes[f"types.{name}.gains"]["p"] == 123
    kind = replace(H24.joints[0].type, return_delay_us=0)  # type: ignore[call-arg]
    other = replace(H24, joints=tuple(replace(joint, type=kind) for joint in H24.joints))
    found = robot_difference(H24, other)
    assert (found.changes, found.restart) == ({}, (f"types.{name}.return_delay_us",))


def test_a_policy_that_the_file_begins_to_say_is_stricter_and_one_that_it_no_longer_says_is_not() -> None:
    silent = replace(H24, gate=replace(H24.gate, on_velocity="reject", request_may_retime=True))
    strict = replace(H24, gate=replace(H24.gate, on_velocity="reject", request_may_retime=False))
    assert robot_difference(silent, strict).changes == {"gate.on_velocity": "reject"}
    assert robot_difference(strict, silent).restart == ("gate.on_velocity",)
    assert applied(silent, {"gate.on_velocity": "reject"}).gate == strict.gate


def test_the_gate_only_gets_stricter() -> None:
    said = replace(H24.gate, request_may_retime=False)
    free = replace(H24, gate=replace(said, on_velocity="retime", on_torque="warn"))
    strict = replace(H24, gate=replace(said, on_velocity="reject", on_torque="reject"))
    found = robot_difference(free, strict)
    assert found.changes == {"gate.on_velocity": "reject", "gate.on_torque": "reject"}
    assert robot_difference(strict, free).restart == ("gate.on_torque", "gate.on_velocity")


@pytest.mark.parametrize(
    ("fields", "key"),
    [
        ({"support": "free"}, "support"),
        ({"rate_hz": 50.0}, "loop.rate_hz"),
        ({"mjcf": "<mujoco/>"}, "model.mjcf"),
        ({"legs": ()}, "legs"),
        ({"motions": Path("elsewhere")}, "motions"),
        ({"poses": {"rest": {}}}, "poses"),
    ],
)
def test_every_other_key_of_the_robot_waits(fields: dict[str, Any], key: str) -> None:
    found = robot_difference(H24, replace(H24, **fields))
    assert (found.changes, found.restart) == ({}, (key,))


@pytest.mark.parametrize("field", ["id", "sign", "ratio", "bus", "mode", "model_joint", "feedback_id"])
def test_every_other_key_of_a_joint_waits(field: str) -> None:
    value = {"id": 77, "sign": 2, "ratio": 9.0, "feedback_id": 99}.get(field, "other")
    found = robot_difference(H24, changed(H24, **{field: value}))
    assert (found.changes, found.restart) == ({}, (f"{YAW}.{field}",))


def test_different_joints_allow_no_change_without_a_restart() -> None:
    found = robot_difference(H24, replace(changed(H24, lower=LOWER + 0.1), joints=H24.joints[1:]))
    assert found.changes == {}
    assert "joints" in found.restart


@pytest.mark.parametrize(
    "changes",
    [
        {f"{YAW}.limits_rad": [LOWER - 0.1, UPPER]},
        {f"{YAW}.limits_rad": [UPPER, LOWER]},
        {f"{YAW}.limits_rad": [math.nan, UPPER]},
        {f"{YAW}.limits_rad": [LOWER]},
        {f"{YAW}.limits_rad": "narrow"},
        {f"{YAW}.velocity_limit_rad_s": 0.0},
        {f"{YAW}.velocity_limit_rad_s": True},
        {f"{YAW}.velocity_limit_rad_s": 1e9},
        {f"{YAW}.id": 1},
        {"joints.nobody.limits_rad": [0.0, 0.1]},
        {"types.xm430.gains": {"p": 1}},
        {f"types.{H24.joints[0].type.name}.gains": {"p": -1, "i": 0, "d": 0}},
        {f"types.{H24.joints[0].type.name}.gains": {"p": 16384, "i": 0, "d": 0}},
        {f"types.{H24.joints[0].type.name}.gains": {"p": math.inf, "i": 0, "d": 0}},
        {"gate.on_velocity": "retime"},
        {"support": "fixed"},
        {"": 1},
    ],
)
def test_a_change_that_needs_a_restart_is_refused_as_a_whole(changes: Mapping[str, Any]) -> None:
    with pytest.raises(InvalidInput):
        applied(H24, {f"{YAW}.acceleration_limit_rad_s2": 1.0, **changes})


@pytest.mark.parametrize(
    "changes",
    [
        {WARN: 51.0},
        {BLOCK: 100.5},
        {WARN: 0.0},
        {WARN: math.nan},
        {WARN: "30"},
        {WARN: 40.0, BLOCK: 30.0},
        {LEVEL: "loud"},
        {LEVEL: ["info"]},
    ],
)
def test_settings_that_no_file_may_have_are_refused(changes: Mapping[str, Any]) -> None:
    with pytest.raises(InvalidInput):
        hot_changes.thresholds(changes, 50.0, 100.0)


# ------------------------------------------------------------------------------------------- properties

SHARES = st.dictionaries(
    st.tuples(st.integers(0, 23), st.sampled_from(["limits", "velocity", "acceleration"])),
    st.floats(0.05, 0.95),
    max_size=8,
)


def shrunk(robot: RobotFile, shares: Mapping[tuple[int, str], float]) -> dict[str, Any]:
    """Hot changes: every named limit at a share of what it was; poses stay inside."""
    found: dict[str, Any] = {}
    for (place, what), share in shares.items():
        joint = robot.joints[place]
        if what == "limits":
            poses = [pose[joint.name] for pose in robot.poses.values()]
            low = min(poses)
            high = max(poses)
            value: Any = [low + share * (joint.lower - low), high + share * (joint.upper - high)]
            found[f"joints.{joint.name}.limits_rad"] = value
        elif what == "velocity":
            found[f"joints.{joint.name}.velocity_limit_rad_s"] = share * joint.velocity_limit
        else:
            found[f"joints.{joint.name}.acceleration_limit_rad_s2"] = share * joint.acceleration_limit
    return found


@given(SHARES)
def test_the_difference_of_applied_changes_equals_them_and_reapplying_is_idempotent(shares: Any) -> None:
    changes = shrunk(H24, shares)
    robot = applied(H24, changes)
    assert dict(robot_difference(H24, robot).changes) == changes
    assert same(applied(robot, changes), robot)
    assert robot_difference(robot, robot).changes == {}


@given(SHARES, st.randoms())
def test_the_order_of_keys_does_not_matter(shares: Any, random: Any) -> None:
    items = list(shrunk(H24, shares).items())
    shuffled = random.sample(items, len(items))
    assert same(applied(H24, dict(items)), applied(H24, dict(shuffled)))


@given(SHARES)
def test_a_reduced_limit_does_not_return_without_a_restart(shares: Any) -> None:
    changes = shrunk(H24, shares)
    found = robot_difference(applied(H24, changes), H24)
    assert found.changes == {}
    assert set(found.restart) == set(changes)


# ------------------------------------------------------------------------------------------- files


def test_settings_split_into_hot_ones_and_those_that_wait(tmp_path: Path) -> None:
    old = describe(files(tmp_path))
    text = "log_level: debug\nthresholds: {latency_warn_ms: 20}\nrate_hz: 50\ncpu: 0\nindividual: b\n"
    found, then = reread_of(old, files(tmp_path, text))
    assert found.changes == {"log_level": "debug", "thresholds.latency_warn_ms": 20.0}
    assert found.restart == ("cpu", "individual", "rate_hz")
    assert (then.settings.log_level, then.settings.latency_warn_ms, then.settings.cpu) == (
        "debug",
        20.0,
        None,
    )
    again = reload_plan.difference(then, describe(files(tmp_path, text)))
    assert (again.changes, again.restart) == ({}, found.restart)


def test_a_file_that_is_in_force_whole_counts_as_read_and_another_does_not(tmp_path: Path) -> None:
    old = describe(files(tmp_path))
    path = str(tmp_path / "body.yaml")
    comment = {"support: gantry": "support: gantry  # as ever"}
    found, then = reread_of(old, files(tmp_path, robot=comment))
    assert (found.changes, found.restart) == ({}, ())
    assert then.files[path] != old.files[path], "nobody is kept from arming by a comment that was read"
    found, then = reread_of(old, files(tmp_path, robot={"support: gantry": "support: fixed"}))
    assert found.restart == ("collision", "support")
    assert then.files[path] == old.files[path], "what is not in force keeps everybody from arming"


def test_a_different_robot_is_detected_by_its_name(tmp_path: Path) -> None:
    old = describe(files(tmp_path))
    other = replace(files(tmp_path), robot="h24-split")
    found, then = reread_of(old, other)
    assert (found.changes, found.restart) == ({}, ("robot",))
    assert same(then.robot, old.robot)


def test_a_bad_file_is_refused_with_its_place(tmp_path: Path) -> None:
    describe(files(tmp_path))
    with pytest.raises(ConfigError, match=r"twind.yaml:3:1: log_levl: unknown key; nearest: log_level"):
        describe(files(tmp_path, "log_levl: debug\n"))


def test_packed_robot_files_unpack_unchanged_and_damaged_bytes_are_refused(tmp_path: Path) -> None:
    sources = files(tmp_path)
    old = describe(sources)
    known, described = unpacked(pack(sources, old))
    assert known == sources
    assert reload_plan.difference(old, described).changes == {}
    for data in (b"", b"nothing", pack(sources, old)[:-5]):
        with pytest.raises(ValueError, match="nothing is known"):
            unpacked(data)


def test_the_page_names_every_hot_key_and_no_other() -> None:
    text = (ROOT / "docs" / "configuration.md").read_text()
    rows = table(text.split("\n## Reload\n")[1], "key", "new value", "while")
    assert {key.strip("`"): value for key, value, _ in rows} == dict(HOT)
    whiles = {key.strip("`"): when for key, _, when in rows}
    assert {key for key, when in whiles.items() if when == "always"} == {*OF_SETTINGS, PROOF}
