"""`twindctl robot finish`: open items of a robot file, settled in the order in which they can be."""

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from twind.client import Client, ClientError
from twind.command_line.keep_torque_off import require_limp
from twind.command_line.verb import DONE, REFUSED, Rejected, observer
from twind.config.calibration_file import Calibration, load_calibration
from twind.config.counts import rad_per_tick
from twind.config.daemon_settings import VIRTUAL_FOLDER
from twind.config.robot_file import read_robot
from twind.config.robot_spec import JointSpec, RobotFile
from twind.config.yaml_tree import ConfigError
from twind.ctl.robot_file_edit import RobotFileEdit
from twind_calibration.calibrating.calibration_context import calibration_path
from twind_calibration.drafting.robot_steps import SUPPORTS
from twind_calibration.robot_description import RobotDescription, read
from twind_drivers.clock import MonotonicClock

MOVED = 0.15  # rad by which a hand must move a joint to tell a direction
MOST_MOVED = 0.375  # turns of a servo: its count may wrap once on the way, and half a turn is either way
FRESH = 500.0  # ms; an older reading tells nothing of a hand
WAIT = 2.0  # s for fresh readings of all joints
MARGIN = 0.03  # rad between a measured end of the travel and the limit
SLACK = 0.05  # rad by which a rest pose may lie beyond the limits, and is moved to them

CALIBRATE = "`twindctl calibrate sweep`, `twindctl calibrate zero`, and this command again"

Ask = Callable[[str], str]


def finish(options: argparse.Namespace) -> int:
    """Settle what can be settled now; return 0 where nothing is open. Raises Rejected, ClientError."""
    described = read(options)
    task = FinishTask(described, RobotFileEdit(described.robot.path), _ask)
    task.settle_answers(options.support, no_watchdog=options.no_watchdog)
    if task.todo:
        task.described = with_calibration_of_daemon(described, options)
    signs = task.open_joints("sign")
    if signs:
        with observer(options) as client:
            task.settle_signs(client, signs)
        print(f"signs are settled: restart the daemon, then {CALIBRATE}")
    elif task.open_joints("limits_rad"):
        task.settle_limits()
    if "poses.rest" in task.todo and not signs and not task.open_joints("limits_rad"):
        with observer(options) as client:
            task.settle_rest(client)
    for item in task.todo:
        print(f"open: {item}")
    if not task.todo:
        path = task.robot.path
        print(f"nothing is open; next: `twindctl check robot {path}`, then restart the daemon in mode live")
    return REFUSED if task.todo else DONE


def with_calibration_of_daemon(described: RobotDescription, options: argparse.Namespace) -> RobotDescription:
    """Return the description with the calibration file that a daemon of this robot reads and writes.

    Unchanged where --calibration names the file, or no daemon of this robot answers. Raises Rejected: its
    servos are virtual.
    """
    if options.calibration:
        return described
    try:
        with observer(options) as client:
            if Path(client.call("GetRobot")["robot"]["path"]).resolve() != described.robot.path.resolve():
                return described
            path = calibration_path(client, described.robot.name)
    except ClientError:
        return described
    if path.parent.name.startswith(VIRTUAL_FOLDER):
        raise Rejected(
            f"the daemon runs virtual servos, with their own calibration {path}: end it; this measures the "
            f"robot itself, with `twind --mode mirror --robot {described.robot.path}` and its ports"
        )
    return replace(described, calibration=path)


def _ask(question: str) -> str:
    try:
        return input(question)
    except EOFError:
        raise Rejected(
            "no more answers on the standard input: what was settled is written; run it again"
        ) from None


class FinishTask:
    """The robot file, its open items and who answers."""

    def __init__(self, described: RobotDescription, edit: RobotFileEdit, ask: Ask) -> None:
        self.described = described
        self.edit = edit
        self.ask = ask
        self.robot: RobotFile = described.robot

    @property
    def todo(self) -> tuple[str, ...]:
        """Open items, in the order of the file."""
        return self.robot.todo

    def open_joints(self, key: str) -> list[JointSpec]:
        """Return the joints of which a key is open."""
        return [joint for joint in self.robot.joints if f"joints.{joint.name}.{key}" in self.todo]

    def settle_answers(self, support: str | None, *, no_watchdog: bool) -> None:
        """Settle what the owner only has to say: what carries the robot, and servos without a watchdog."""
        if "support" in self.todo:
            answer = support or ""
            while answer not in SUPPORTS:
                answer = self.ask(f"What carries the robot: {', '.join(SUPPORTS)}? ").strip()
            self._write({"support": answer})
        for item in [each for each in self.todo if each.endswith(".watchdog")]:
            device = next(
                joint.type.device for joint in self.robot.joints if joint.type.name == item.split(".")[1]
            )
            question = (
                f"{device}: without a watchdog it holds its last goal when the daemon dies. Accept (yes)? "
            )
            if not no_watchdog and self.ask(question).strip() != "yes":
                raise Rejected(f"{item} stays open: {device} servos are armed only where that is accepted")
            self._write({item: "none"})

    def settle_signs(self, client: Client, joints: Sequence[JointSpec]) -> None:
        """Have each joint moved by hand; write its sign. Raises Rejected: torque is on, or another file."""
        self._require_same(client)
        require_limp(client, MonotonicClock())  # a joint that holds would be moved against its torque
        for joint in joints:
            sign = self._sign(client, joint)
            self._write({f"joints.{joint.name}.sign": str(sign)})

    def settle_limits(self) -> None:
        """Take limits from the measured travel. Raises Rejected: a joint is not calibrated."""
        known = self._calibration().by_name
        values: dict[str, str] = {}
        for joint in self.open_joints("limits_rad"):
            entry = known.get(joint.actuator)
            if entry is None:
                raise Rejected(f"{joint.name} is not calibrated: {CALIBRATE}")
            unit = rad_per_tick(joint)
            low, high = sorted((tick - entry.zero_ticks) * unit for tick in entry.sweep_ticks)
            values[f"joints.{joint.name}.limits_rad"] = f"[{low + MARGIN:.3f}, {high - MARGIN:.3f}]"
        self._write(values)

    def settle_rest(self, client: Client) -> None:
        """Take the pose in which the limp robot lies as `poses.rest`.

        Raises Rejected: not calibrated, or torque is on.
        """
        known = self._calibration().by_name
        missing = [joint.name for joint in self.robot.joints if joint.actuator not in known]
        if missing:
            raise Rejected(f"{', '.join(missing[:5])}: not calibrated: {CALIBRATE}")
        self._require_calibrated(client)
        self.ask("Lay the robot where nothing falls without torque, then press Enter ")
        require_limp(client, MonotonicClock())  # a robot that holds itself shows no place where it lies
        positions = _positions(client)
        pose: dict[str, float] = {}
        for joint in self.robot.joints:
            place = positions[joint.name]
            inside = min(max(place, joint.lower), joint.upper)
            if abs(place - inside) > SLACK:
                raise Rejected(
                    f"{joint.name} lies at {place:.3f} rad, outside its limits {joint.lower:g}.."
                    f"{joint.upper:g}: lay it inside, or widen limits_rad"
                )
            pose[joint.name] = inside
        # `+ 0.0` after rounding: -0.000 becomes 0.000
        text = ", ".join(f"{name}: {round(place, 3) + 0.0:.3f}" for name, place in pose.items())
        self._write({"poses.rest": f"{{{text}}}"})

    def _sign(self, client: Client, joint: JointSpec) -> int:
        """Return the sign by which a movement of the hand in the positive direction is positive."""
        while True:
            self.ask(f"{joint.name}: hold the robot still and press Enter ")
            before = _positions(client)
            self.ask(f"{joint.name}: move it by 20 to 40 degrees in its positive direction, and press Enter ")
            after = _positions(client)
            moves = {
                each.name: _shortest(after[each.name] - before[each.name], each) for each in self.robot.joints
            }
            most = max(moves, key=lambda name: abs(moves[name]))
            if abs(moves[most]) > MOST_MOVED * _turn(self.robot.joints[self.robot.names.index(most)]):
                print(f"{most} moved by more than {MOST_MOVED:g} of a turn of its servo: move it less")
            elif most == joint.name and abs(moves[most]) >= MOVED:
                return joint.sign if moves[most] > 0.0 else -joint.sign
            elif abs(moves[most]) < MOVED:
                print(f"nothing moved by {MOVED} rad; {joint.name} by {moves.get(joint.name, 0.0):.3f}")
            else:
                print(
                    f"{most} moved by {moves[most]:+.2f} rad, not {joint.name}: are their ids interchanged?"
                )

    def _require_same(self, client: Client) -> None:
        robot = client.call("GetRobot")["robot"]
        # Answers of this run about support and watchdogs change no reading.
        if robot["text_sha256"] not in (self.robot.text_sha256, self.described.robot.text_sha256):
            raise Rejected(
                f"the daemon has read another robot file than {self.robot.path}, or an earlier state of it: "
                f"restart it with `twind --mode mirror --robot {self.robot.path}` and its ports, then run "
                "this command again"
            )

    def _require_calibrated(self, client: Client) -> None:
        answer = client.call("GetStatus", joints=True)
        status = answer["status"]
        raw = [each["name"] for each in answer["joints"] if not each["calibrated"]]
        if status["robot"] != self.robot.name or status["mode"] == "sim" or raw:
            lacks = (
                f"{', '.join(raw[:5])} not calibrated" if raw else f"{status['robot']} in {status['mode']}"
            )
            raise Rejected(
                f"the daemon has {lacks}: start it with `twind --mode mirror --robot {self.robot.path}`, "
                "its ports and its calibration"
            )

    def _calibration(self) -> Calibration:
        path = self.described.calibration or self.described.usual
        try:
            return load_calibration(path, self.robot)
        except ConfigError as error:
            if error.absent:
                raise Rejected(f"there is no calibration yet at {path}: {CALIBRATE}") from None
            raise Rejected(str(error)) from None

    def _write(self, values: Mapping[str, str]) -> None:
        for key, value in values.items():
            self.edit.put(key, value)
            self.edit.settle(key)
        self.edit.save()
        self.robot = read_robot(self.robot.path)
        for key, value in values.items():
            print(f"settled: {key}: {value}", flush=True)


def _turn(joint: JointSpec) -> float:
    """Return one turn of the joint's servo, rad of the joint."""
    return joint.type.ticks_per_turn * abs(rad_per_tick(joint))


def _shortest(move: float, joint: JointSpec) -> float:
    """Return a move as the shortest of those that a count which wraps may show."""
    turn = _turn(joint)
    return move - turn * round(move / turn)


def _positions(client: Client) -> dict[str, float]:
    """Return the positions (rad) by joint, once all are fresh. Raises Rejected: one is not read for 2 s."""
    clock = MonotonicClock()
    deadline = clock.now() + WAIT
    while True:
        joints = client.call("GetStatus", joints=True)["joints"]
        stale = [each["name"] for each in joints if not _is_fresh(each)]
        if not stale:
            return {each["name"]: each["position"] for each in joints}
        if clock.now() > deadline:
            raise Rejected(f"{', '.join(stale[:5])}: no fresh reading; check power, cable and port")
        clock.sleep_until(clock.now() + 0.05)


def _is_fresh(joint: Mapping[str, Any]) -> bool:
    return joint["position"] is not None and joint["heard"] and joint["age_ms"] <= FRESH
