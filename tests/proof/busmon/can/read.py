"""The limits of a CAN bus from the robot file and the calibration file, read on its own."""

import math
from pathlib import Path
from typing import Any

import yaml

from tests.proof.busmon.can.motors import TURN, CanLimits, Motor, motor
from tests.proof.busmon.limits import BEYOND

KINDS = {"DM": "damiao", "AK": "cubemars", "RS": "robstride", "EL": "robstride", "CyberGear": "robstride"}
KINDS |= {"ODrive": "odrive"}
REPLY = 0x10  # a Damiao answers with its id and this, where nothing else is said


def is_can(robot_file: Path, bus: str) -> bool:
    """Is that bus of the robot a CAN bus?"""
    robot = yaml.safe_load(Path(robot_file).read_text(encoding="utf-8"))
    return str(robot["buses"][bus]["kind"]) == "can"


def read(robot_file: Path, calibration_file: Path, bus: str, *, rate_hz: float | None = None) -> CanLimits:
    """Raises KeyError, ValueError: something is missing or makes no sense."""
    robot = yaml.safe_load(Path(robot_file).read_text(encoding="utf-8"))
    calibration = yaml.safe_load(Path(calibration_file).read_text(encoding="utf-8"))
    rate = float(rate_hz or (robot.get("loop") or {}).get("rate_hz", 100.0))
    if not 1.0 <= rate <= 1000.0:
        raise ValueError(f"a rate of {rate} Hz")
    motors: dict[int, Motor] = {}
    for name, own in robot["joints"].items():
        joint = {**(robot.get("defaults") or {}), **own}
        if joint["bus"] == bus:
            made = _motor(name, joint, robot["types"][joint["type"]], calibration["joints"][name])
            if made.id in motors:
                raise ValueError(f"id {made.id} twice on {bus}")
            motors[made.id] = made
    if not motors:
        raise ValueError(f"no motor on bus {bus}")
    bitrate = int(robot["buses"][bus].get("bitrate", 1_000_000))
    return CanLimits(bus, 1.0 / rate, bitrate, str(robot.get("support", "free")), motors)


def _motor(name: str, joint: dict[str, Any], kind: dict[str, Any], measured: dict[str, Any]) -> Motor:
    family = next((each for start, each in KINDS.items() if str(kind["device"]).startswith(start)), "")
    sign = int(joint.get("sign", 1))
    ratio = float(joint.get("ratio", 1.0))
    if sign not in (1, -1) or not ratio > 0.0:
        raise ValueError(f"{name}: sign {sign}, ratio {ratio}")
    if int(measured["id"]) != int(joint["id"]) or int(measured["sign"]) != sign:
        raise ValueError(f"{name}: the calibration is of another motor")
    id = int(joint["id"])
    own = kind["ranges"]
    spans = tuple(float(own[each]) for each in ("position_rad", "velocity_rad_s", "torque_nm"))
    return motor(
        id,
        name,
        family,
        (spans[0], spans[1], spans[2]),
        _ends(joint["limits_rad"], sign * ratio, measured, spans[0]),
        _least(joint, kind, "velocity_limit_rad_s", 2.0, ratio) * ratio,
        _least(joint, kind, "acceleration_limit_rad_s2", 10.0, ratio) * ratio,
        reply=int(joint.get("feedback_id", id + REPLY)) if family == "damiao" else id,
    )


def _ends(limits: list[float], gear: float, measured: dict[str, Any], span: float) -> tuple[float, float]:
    """Angles (rad) of the motor inside the hard limits, the measured travel, and what its field holds."""
    if not limits[0] < limits[1]:
        raise ValueError(f"limits {limits}")
    count = math.tau / TURN
    zero = int(measured["zero_ticks"]) * count
    low, high = sorted((zero + gear * (limits[0] - BEYOND), zero + gear * (limits[1] + BEYOND)))
    sweep = sorted(int(each) * count for each in measured["sweep_ticks"])
    return max(low, sweep[0], -span), min(high, sweep[1], span)


def _least(joint: dict[str, Any], kind: dict[str, Any], key: str, default: float, ratio: float) -> float:
    """The tightest of type and joint, at the joint."""
    found = min(float(kind.get(key, default)) / ratio, float(joint.get(key, math.inf)))
    if not 0.0 < found < math.inf:
        raise ValueError(f"{key} {found}")
    return found
