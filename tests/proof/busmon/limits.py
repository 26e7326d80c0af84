"""Permitted commands of each servo of a bus, from the robot file and the calibration file, read on its own.

Knows the X series (control tables 0..63 EEPROM, 64.. RAM) STS servos and the MX-28 of Protocol 1.0.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from tests.proof.busmon.protocol1.protocol1_packets import MX, STS, Registers

BEYOND = 0.05  # rad past `limits_rad` that the robot's hard limits lie
MODES = {"position": 3, "extended_position": 4, "current_based_position": 5}
TABLES = {"STS": STS, "MX-28(1.0)": MX}  # by the beginning of a model's name
X_SERIES = ("XL", "XC", "XM", "XH", "XD", "XW", "2X")
TURNS = 1_048_575  # counts either way in the modes that have no limit registers
# A a count (e-manual, Goal Current), where the robot file says nothing else: of most X series servos, of some
AMPERE = 0.00269
SMALL_AMPERE = 0.001
SMALL = ("XL330", "XC330")
MOST_CURRENT = 2047
SEARCHED = 0.2  # rad beyond its stop that a joint may be sent in search of it ...
SLOWLY = 0.5  # rad/s ...
WEAKLY = 0.15  # of the current limit


@dataclass(frozen=True)
class Servo:
    """One servo, in its own counts."""

    id: int
    name: str
    mode: int  # 3, 4 or 5
    lower: int  # smallest goal word
    upper: int  # largest goal word
    speed: float  # counts/s, fastest that a goal may move
    brake: float  # counts/s², the acceleration limit
    cap: int  # largest goal current
    turn: int  # counts of a turn
    middle: float  # count in the middle of its travel; which turn is meant is the one nearest to it
    stops: tuple[int, int]  # smallest and largest goal word of a search for its stop
    slow: float  # counts/s of such a search
    weak: int  # largest goal current of it


@dataclass(frozen=True)
class Limits:
    """Limits of one bus. `servos` by id."""

    bus: str
    period: float  # s, nominal, between two goals
    baud: int
    support: str
    servos: dict[int, Servo]
    registers: Registers | None = None  # of servos with packets of the first protocol
    sensors: frozenset[int] = frozenset()  # ids of the bus that are read and never written

    @classmethod
    def read(
        cls, robot_file: Path, calibration_file: Path, bus: str, *, rate_hz: float | None = None
    ) -> "Limits":
        """From the two files. Raises KeyError, ValueError: something is missing or makes no sense."""
        robot = yaml.safe_load(Path(robot_file).read_text(encoding="utf-8"))
        calibration = yaml.safe_load(Path(calibration_file).read_text(encoding="utf-8"))
        rate = float(rate_hz or (robot.get("loop") or {}).get("rate_hz", 100.0))
        if not 1.0 <= rate <= 1000.0:
            raise ValueError(f"a rate of {rate} Hz")
        servos = {}
        registers = None
        for name, own in robot["joints"].items():
            joint = {**(robot.get("defaults") or {}), **own}
            if joint["bus"] == bus:
                servo = _servo(name, joint, robot["types"][joint["type"]], calibration["joints"][name])
                if servo.id in servos:
                    raise ValueError(f"id {servo.id} twice on {bus}")
                servos[servo.id] = servo
                registers = _registers(name, robot["types"][joint["type"]])
        if not servos:
            raise ValueError(f"no servo on bus {bus}")
        baud = int(robot["buses"][bus].get("baud", 1_000_000))
        read = (robot.get("sensors") or {}).values()
        sensors = frozenset(int(sensor["id"]) for sensor in read if sensor["bus"] == bus)
        return cls(bus, 1.0 / rate, baud, str(robot.get("support", "free")), servos, registers, sensors)


def _registers(name: str, kind: dict[str, Any]) -> Registers | None:
    """Memory table of a servo; None: of the X series."""
    device = str(kind["device"])
    if device.startswith(X_SERIES):
        return None
    for beginning, table in TABLES.items():
        if device.startswith(beginning):
            return table
    raise ValueError(f"{name}: {device} is not of the X series: its registers are not known here")


def _servo(name: str, joint: dict[str, Any], kind: dict[str, Any], measured: dict[str, Any]) -> Servo:
    _registers(name, kind)
    mode = MODES[joint.get("mode", kind.get("mode", "position"))]
    sign = int(joint.get("sign", 1))
    ratio = float(joint.get("ratio", 1.0))
    if sign not in (1, -1) or not ratio > 0.0:
        raise ValueError(f"{name}: sign {sign}, ratio {ratio}")
    if int(measured["id"]) != int(joint["id"]) or int(measured["sign"]) != sign:
        raise ValueError(f"{name}: the calibration is of another servo")
    turn = int(kind.get("ticks_per_turn", 4096))
    each = sign / ratio * math.tau / turn  # rad a count
    lower, upper = _range(joint["limits_rad"], each, mode, measured)
    sweep = [int(count) for count in measured["sweep_ticks"]]
    full = float(kind.get("current_limit_a", 0.0)) / _ampere(kind)
    if not lower < upper:
        raise ValueError(f"{name}: no count between {lower} and {upper}")
    return Servo(
        id=int(joint["id"]),
        name=name,
        mode=mode,
        lower=lower,
        upper=upper,
        speed=_least(joint, kind, "velocity_limit_rad_s", 2.0, ratio) / abs(each),
        brake=_least(joint, kind, "acceleration_limit_rad_s2", 10.0, ratio) / abs(each),
        cap=_cap(mode, kind),
        turn=turn,
        middle=sum(sweep) / 2.0,
        stops=_stops(joint.get("stop_rad") or {}, each, int(measured["zero_ticks"]), lower, upper),
        slow=SLOWLY / abs(each),
        weak=math.floor(WEAKLY * full),
    )


def _stops(described: dict[str, float], each: float, zero: int, lower: int, upper: int) -> tuple[int, int]:
    """Its range, and on a side whose stop is described as far as a search may go there."""
    way = {"lower": -1.0, "upper": 1.0}
    ends = [zero + (rad + way[side] * SEARCHED) / each for side, rad in described.items()]
    return math.floor(min([lower, *ends])) - 1, math.ceil(max([upper, *ends])) + 1


def _range(limits: list[float], each: float, mode: int, measured: dict[str, Any]) -> tuple[int, int]:
    """Counts inside the hard limits, the measured travel, and the limit registers that mode 3 obeys."""
    if not limits[0] < limits[1]:
        raise ValueError(f"limits {limits}")
    zero = int(measured["zero_ticks"])
    ends = sorted(((limits[0] - BEYOND) / each, (limits[1] + BEYOND) / each))
    low = zero + math.ceil(ends[0] - 1e-9)
    high = zero + math.floor(ends[1] + 1e-9)
    sweep = sorted(int(count) for count in measured["sweep_ticks"])
    low = max(low, sweep[0], -TURNS)
    high = min(high, sweep[1], TURNS)
    if mode == 3:
        kept = measured["device"]["eeprom"]
        low = max(low, int(kept["min_ticks"]))
        high = min(high, int(kept["max_ticks"]))
    return low, high


def _least(joint: dict[str, Any], kind: dict[str, Any], key: str, default: float, ratio: float) -> float:
    """The tightest of type and joint, at the joint."""
    found = min(float(kind.get(key, default)) / ratio, float(joint.get(key, math.inf)))
    if not 0.0 < found < math.inf:
        raise ValueError(f"{key} {found}")
    return found


def _cap(mode: int, kind: dict[str, Any]) -> int:
    if mode != 5 or "current_limit_a" not in kind:
        return MOST_CURRENT
    return math.floor(float(kind["current_limit_a"]) / _ampere(kind) + 1e-9)


def _ampere(kind: dict[str, Any]) -> float:
    """A a count of a servo."""
    usual = SMALL_AMPERE if str(kind["device"]).startswith(SMALL) else AMPERE
    return float(kind.get("current_lsb_a", usual))
