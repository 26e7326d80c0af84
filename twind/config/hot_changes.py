"""Changes that apply while the daemon runs, and those that need a restart. Pure: read files in, values out.

A change is a key, spelled as in the files, and its new value. Limits only shrink and rules only get stricter;
everything that is not in `HOT` needs a restart. The front works changes out and the loop applies them: both
by the functions here, so that both judge the same robot.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from math import isfinite
from typing import Any

from twind.config.actuator_types import TypeSpec
from twind.config.daemon_settings import LATENCY_BLOCK_MS, LATENCY_WARN_MS, LEVELS, DaemonSettings
from twind.config.hot_keys import BLOCK, LEVEL, OF_SETTINGS, PROOF, WARN, of_robot
from twind.config.robot_spec import JointSpec, RobotFile
from twind.exceptions import InvalidInput

Changes = Mapping[str, Any]  # key -> new value: numbers, texts, lists and mappings of them

# Key -> how it may change. Those of the robot file at rest, the others at any time.
HOT: Mapping[str, str] = {
    "log_level": "any",
    "thresholds.latency_warn_ms": "any that the file may have",
    "thresholds.latency_block_ms": "any that the file may have",
    PROOF: "any, where nothing else of the calibration differs",
    "joints.JOINT.limits_rad": "narrower, with every pose still inside",
    "joints.JOINT.velocity_limit_rad_s": "smaller",
    "joints.JOINT.acceleration_limit_rad_s2": "smaller",
    "types.TYPE.gains": "any that the file may have",
    "gate.on_velocity": "`reject`",
    "gate.on_torque": "`reject`",
}
LIMITS = "limits_rad"
VELOCITY = "velocity_limit_rad_s"
ACCELERATION = "acceleration_limit_rad_s2"
STRICT = "reject"

# Field of the settings -> key of the file, where they differ; what is not told apart by it is None.
_SETTING = {"socket_dir": "sockets", "robot_folders": None, "source": None, "origins": None}
_OF_JOINTS = frozenset({"lower", "upper", "velocity_limit", "acceleration_limit", "type", "travel"})
_OF_SLOTS = frozenset({"bus", "id", "sign", "ratio", "registers", "mode", "feedback_id"})
_JOINT = {"stops": "stop_rad", "own_follow_rad": "follow_rad", "own_follow_s": "follow_s"}
_ROBOT = {"mjcf": "model.mjcf", "mjcf_path": "model.mjcf", "base": "model.base", "rate_hz": "loop.rate_hz"}
_ROBOT |= {"compensate_gravity": "loop.compensate_gravity"}
_ROBOT |= {"command_timeout_ms": "loop.command_timeout_ms", "imu": "sensors.imu", "relay": "power.relay"}


@dataclass(frozen=True, slots=True)
class ConfigDifference:
    """Differences: hot changes, and the keys that need a restart, in order."""

    changes: Changes
    restart: tuple[str, ...]


def same(one: Any, other: Any) -> bool:
    """Equal to the last number, where what is unknown (NaN) is the same as what is unknown."""
    if is_dataclass(one) and type(one) is type(other):
        return all(same(getattr(one, field.name), getattr(other, field.name)) for field in fields(one))
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return bool(one == other) or (one != one and other != other)


# ------------------------------------------------------------------------------------------- settings


def settings_difference(old: DaemonSettings, new: DaemonSettings) -> ConfigDifference:
    """Return the changes of the settings."""
    hot = {key: value for key, value in _hot_settings(new).items() if value != _hot_settings(old)[key]}
    names = {field.name for field in fields(DaemonSettings)} - {LEVEL, "latency_warn_ms", "latency_block_ms"}
    keys = {name: _SETTING.get(name, name) for name in names}
    restart = {key for name, key in keys.items() if key and not same(getattr(old, name), getattr(new, name))}
    return ConfigDifference(hot, tuple(sorted(restart)))


def _hot_settings(settings: DaemonSettings) -> dict[str, Any]:
    return {LEVEL: settings.log_level, WARN: settings.latency_warn_ms, BLOCK: settings.latency_block_ms}


def settled(settings: DaemonSettings, changes: Changes) -> DaemonSettings:
    """The settings with the changes that are theirs. Raises InvalidInput."""
    wanted = _hot_settings(settings) | {key: changes[key] for key in changes if key in OF_SETTINGS}
    warn, block = thresholds(wanted, settings.latency_warn_ms, settings.latency_block_ms)
    return replace(settings, log_level=wanted[LEVEL], latency_warn_ms=warn, latency_block_ms=block)


def thresholds(changes: Changes, warn: float, block: float) -> tuple[float, float]:
    """Latency warned of and refused above (ms), from those in force and the changes of settings.

    Raises InvalidInput for any of these that no settings file may have.
    """
    if changes.get(LEVEL, LEVELS[0]) not in LEVELS:
        raise InvalidInput(f"{changes[LEVEL]!r} is none of {', '.join(LEVELS)}", where=LEVEL)
    warn = _number(WARN, changes.get(WARN, warn))
    block = _number(BLOCK, changes.get(BLOCK, block))
    for key, value, most in ((WARN, warn, LATENCY_WARN_MS), (BLOCK, block, LATENCY_BLOCK_MS)):
        if not 0.0 < value <= most:
            raise InvalidInput(f"{value:g} must be above 0 and at most {most:g}", where=key)
    if block < warn:
        raise InvalidInput(f"{block:g} is below {WARN}, {warn:g}", where=BLOCK)
    return warn, block


# ------------------------------------------------------------------------------------------- robot


def robot_difference(old: RobotFile, new: RobotFile) -> ConfigDifference:
    """Return the changes of the robot. With other joint names, nothing is hot."""
    ignored = {"joints", "gate", "text_sha256"}
    names = {field.name for field in fields(RobotFile)} - ignored
    restart = {_ROBOT.get(name, name) for name in names if not same(getattr(old, name), getattr(new, name))}
    if old.names != new.names:
        return ConfigDifference({}, tuple(sorted({*restart, "joints"})))
    changes, cold = _gate_difference(old, new)
    restart |= cold
    for before, after in zip(old.joints, new.joints, strict=True):
        hot, cold = _joint_difference(before, after, old.poses)
        changes |= hot
        restart |= cold
    return ConfigDifference(changes, tuple(sorted(restart)))


def _gate_difference(old: RobotFile, new: RobotFile) -> tuple[dict[str, Any], set[str]]:
    hot: dict[str, Any] = {}
    cold = {"collision"} if not same(old.gate.collision, new.gate.collision) else set()
    if old.gate.contact_hold_nm != new.gate.contact_hold_nm:
        cold.add("gate.contact.hold_nm")
    for name in ("on_velocity", "on_torque"):
        before = getattr(old.gate, name)
        after = getattr(new.gate, name)
        if name == "on_velocity" and old.gate.request_may_retime:
            before = ""  # looser than `reject` of a file that says it
        if name == "on_velocity" and new.gate.request_may_retime:
            after = ""
        if before != after and after == STRICT:
            hot[f"gate.{name}"] = after
        elif before != after:
            cold.add(f"gate.{name}")
    return hot, cold


def _joint_difference(
    old: JointSpec, new: JointSpec, poses: Mapping[str, Mapping[str, float]]
) -> tuple[dict[str, Any], set[str]]:
    """`poses`: those in force, which must stay inside the limits."""
    names = {field.name for field in fields(JointSpec)} - _OF_JOINTS
    cold = {_key(old, name) for name in names if not same(getattr(old, name), getattr(new, name))}
    wanted: dict[str, Any] = {}
    if (old.lower, old.upper) != (new.lower, new.upper):
        wanted[f"joints.{old.name}.{LIMITS}"] = [new.lower, new.upper]
    if old.velocity_limit != new.velocity_limit:
        wanted[f"joints.{old.name}.{VELOCITY}"] = new.velocity_limit
    if old.acceleration_limit != new.acceleration_limit:
        wanted[f"joints.{old.name}.{ACCELERATION}"] = new.acceleration_limit
    hot: dict[str, Any] = {}
    for key, value in wanted.items():
        try:
            _tightened(old, key, value, poses)
            hot[key] = value
        except InvalidInput:
            cold.add(key)
    gains, others = _type_difference(old, new)
    return hot | gains, cold | others


def _key(joint: JointSpec, name: str) -> str:
    """Return the key of a joint's field in the file."""
    if joint.transmission and name in _OF_SLOTS:
        return f"actuators.{joint.actuator}.{name}"
    return f"joints.{joint.name}.{_JOINT.get(name, name)}"


def _type_difference(old: JointSpec, new: JointSpec) -> tuple[dict[str, Any], set[str]]:
    was = old.type
    now = new.type
    if was.name != now.name:
        return {}, {f"joints.{old.name}.type"}
    if type(was) is not type(now):
        return {}, {f"types.{was.name}.device"}
    names = {field.name for field in fields(was)} - {"gains"}
    cold = {f"types.{was.name}.{name}" for name in names if not same(getattr(was, name), getattr(now, name))}
    before = _gains(was)
    after = _gains(now)
    return ({f"types.{was.name}.gains": after} if before != after else {}), cold


def gains_of(robot: RobotFile) -> dict[str, dict[str, Any]]:
    """Return the gains of each type of its joints, by their key."""
    return {f"types.{joint.type.name}.gains": _gains(joint.type) for joint in robot.joints}


def _gains(kind: TypeSpec) -> dict[str, Any]:
    gains: Any = kind.gains  # type: ignore[attr-defined]  # every kind has its own
    return {field.name: getattr(gains, field.name) for field in fields(gains)}


def applied(robot: RobotFile, changes: Changes) -> RobotFile:
    """The robot with the changes that are its own: all of them, or InvalidInput is raised."""
    joints = {joint.name: joint for joint in robot.joints}
    types = {joint.type.name: joint.type for joint in robot.joints}
    gate = robot.gate
    for key, value in of_robot(changes).items():
        kind, _, rest = key.partition(".")
        name, _, what = rest.rpartition(".")
        if kind == "joints" and name in joints:
            joints[name] = _tightened(joints[name], key, value, robot.poses)
        elif kind == "types" and name in types and what == "gains":
            types[name] = _driven(types[name], key, value)
        elif key in ("gate.on_velocity", "gate.on_torque") and value == STRICT:
            open_ = gate.request_may_retime and rest != "on_velocity"
            gate = replace(gate, **{rest: value}, request_may_retime=open_)
        else:
            raise InvalidInput(f"may not become {value!r} while the daemon runs", where=key)
    made = tuple(replace(joint, type=types[joint.type.name]) for joint in joints.values())
    return replace(robot, joints=made, gate=gate)


def _tightened(joint: JointSpec, key: str, value: Any, poses: Mapping[str, Mapping[str, float]]) -> JointSpec:
    what = key.rpartition(".")[2]
    if what == LIMITS:
        return _narrowed(joint, key, value, poses)
    if what == VELOCITY:
        return replace(joint, velocity_limit=_lowered(key, value, joint.velocity_limit))
    if what == ACCELERATION:
        return replace(joint, acceleration_limit=_lowered(key, value, joint.acceleration_limit))
    raise InvalidInput("needs a restart", where=key)


def _lowered(key: str, value: Any, most: float) -> float:
    number = _number(key, value)
    if not 0.0 < number <= most:
        raise InvalidInput(
            f"{number:g} is not above 0 and at most {most:g}, as in force: restart for that", where=key
        )
    return number


def _narrowed(joint: JointSpec, key: str, value: Any, poses: Mapping[str, Mapping[str, float]]) -> JointSpec:
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != 2:
        raise InvalidInput(f"{value!r} is not a lower and an upper limit", where=key)
    lower = _number(key, value[0])
    upper = _number(key, value[1])
    if not joint.lower <= lower < upper <= joint.upper:
        bounds = f"{joint.lower:g}..{joint.upper:g}"
        raise InvalidInput(
            f"{lower:g}..{upper:g} is not within {bounds}, as in force: restart for that", where=key
        )
    for name, pose in poses.items():
        if not lower <= pose[joint.name] <= upper:
            raise InvalidInput(
                f"{lower:g}..{upper:g} leaves {pose[joint.name]:g} of pose {name} outside", where=key
            )
    return replace(joint, lower=lower, upper=upper)


def _driven(kind: TypeSpec, key: str, value: Any) -> TypeSpec:
    known = kind.gain_limits
    if not isinstance(value, Mapping) or set(value) != set(known):
        raise InvalidInput(f"{value!r}: expected {', '.join(known)}", where=key)
    numbers = {name: _number(f"{key}.{name}", value[name]) for name in known}
    for name, most in kind.gain_limits.items():
        if not 0.0 <= (number := numbers[name]) <= most:
            raise InvalidInput(f"{number:g} is outside 0 to {most:g}", where=f"{key}.{name}")
    return kind.with_gains(numbers)


def _number(key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        raise InvalidInput(f"{value!r} is no finite number", where=key)
    return float(value)
