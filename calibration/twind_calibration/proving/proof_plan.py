"""Plan of a proof: base pose and angles of neighbours for each joint, by the model. Nothing moves.

From the robot file alone. Bases that are each other's mirror image show the same, so three are looked at.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from math import radians
from typing import Any

import numpy as np

from twind.command_line.verb import DONE, Rejected, show
from twind.config.robot_file import load_robot
from twind.config.robot_spec import RobotFile
from twind.config.yaml_tree import ConfigError
from twind.ctl.hint_options import command_hint
from twind.exceptions import InvalidInput
from twind.robot.arrays import Floats
from twind_calibration.proving.expected_loads import look_ahead, strained
from twind_calibration.proving.proof_sweep import sweeps
from twind_calibration.proving.sign_proof import LoadPrediction
from twind_calibration.rejection_hints import unknown_joint
from twind_calibration.wiggling.posed_model import PosedModel

BASES = ("upright", "back", "left")
BEND = 1.0  # rad, a neighbour is bent so far at most
CLEAR = 0.05  # rad that it keeps from its limits


@dataclass(frozen=True, slots=True)
class ProofPlan:
    """Best way to prove one joint. `bend` None: the rest pose."""

    joint: int
    base: str
    bend: tuple[int, float] | None  # a joint, rad
    foreseen: LoadPrediction
    strains: bool  # it holds much of what it can

    @property
    def is_usable(self) -> bool:
        """True when the plan proves the joint without overloading it."""
        return self.foreseen.observable and not self.strains


def best(body: PosedModel, joint: int, size: float, friction: float) -> ProofPlan | None:
    """Return the simplest way that proves a joint, else the most informative one; None: it cannot move.

    Order: at rest before bent, the joint itself before others, without strain before with strain. Changes the
    base of the body.
    """
    rest = np.array([body.robot.poses["rest"][name] for name in body.robot.names])
    found: list[ProofPlan] = []
    for bends in ([None], _middle(body.robot, joint), list(_bends(body.robot, joint))):
        for base in BASES:
            body.lie(base)
            for bend in bends:
                seen = _seen(body, rest, joint, bend, size, friction)
                found += [] if seen is None else [ProofPlan(joint, base, bend, *seen)]
        if any(way.is_usable for way in found):
            break
    return max(found, key=lambda way: (way.is_usable, way.foreseen.apart), default=None)


def _seen(
    body: PosedModel, rest: Floats, joint: int, bend: tuple[int, float] | None, size: float, friction: float
) -> tuple[LoadPrediction, bool] | None:
    """Return the predicted loads, and whether the pose overloads the joint."""
    pose = rest.copy()
    spec = body.robot.joints[joint]
    if bend is not None:
        pose[bend[0]] = bend[1]
    ways = sweeps(float(pose[joint]), spec.lower, spec.upper, size)
    if not ways or body.stands_on(joint) or spec.transmission:
        return None
    ahead = look_ahead(body, pose, joint, ways[0].places[[0, len(ways[0].places) // 2, -1]], friction)
    return ahead, joint in strained(body, pose)


def _middle(robot: RobotFile, joint: int) -> list[tuple[int, float]]:
    """The joint itself in the middle of its travel: a mirrored one stands there too, and its load differs."""
    spec = robot.joints[joint]
    middle = round((spec.lower + spec.upper) / 2.0, 2)
    return [(joint, middle)] if abs(middle) > CLEAR else []


def _bends(robot: RobotFile, joint: int) -> Iterator[tuple[int, float]]:
    """Yield every other joint, in either direction as far as its limits allow."""
    for other, spec in enumerate(robot.joints):
        for angle in (max(-BEND, spec.lower + CLEAR), min(BEND, spec.upper - CLEAR)):
            if other != joint and abs(angle) > CLEAR:
                yield other, angle


def print_plan(options: argparse.Namespace) -> int:
    """Print the plan. Exit code 0. Raises Rejected, ClientError (no --robot, and no daemon)."""
    robot = _robot(options)
    try:
        body = PosedModel(robot)
    except InvalidInput as error:
        raise Rejected(str(error)) from None
    for name in options.joints:
        if name not in robot.names:
            raise unknown_joint(robot.name, name, robot.names)
    chosen = [place for place, name in enumerate(robot.names) if name in options.joints or not options.joints]
    size = radians(options.degrees)
    friction = float(options.friction)
    ways = {place: best(body, place, size, friction) for place in chosen}
    rows = [_row(robot, place, way) for place, way in ways.items()]
    show(
        options,
        {"robot": robot.name, "joints": rows},
        command_hint(options).prose("\n".join(_lines(body, rows))),
    )
    return DONE


def _robot(options: argparse.Namespace) -> RobotFile:
    if options.robot is None:
        from twind.command_line.verb import observer
        from twind_calibration.calibrating.calibration_context import ground

        with observer(options) as client:
            return ground(options, client).robot
    try:
        return load_robot(options.robot)
    except ConfigError as error:
        raise Rejected(str(error)) from None


def _row(robot: RobotFile, place: int, way: ProofPlan | None) -> dict[str, Any]:
    bend = None if way is None or way.bend is None else f"{robot.names[way.bend[0]]}={way.bend[1]:g}"
    return {
        "joint": robot.names[place],
        "observable": way is not None and way.foreseen.observable,
        "base_pose": None if way is None else way.base,
        "with": bend,
        "flip_nm": None if way is None else way.foreseen.flip,
        "apart_nm": None if way is None else way.foreseen.apart,
        "slack_nm": None if way is None else way.foreseen.slack,
    }


def _strain(body: PosedModel, base: str, bend: str | None) -> list[str]:
    """Return a line that names the joints to support in this pose; [] where none is strained."""
    angles = dict(body.robot.poses["rest"])
    if bend is not None:
        name, _, angle = bend.partition("=")
        angles[name] = float(angle)
    body.lie(base)
    said = strained(body, np.array([angles[name] for name in body.robot.names])).values()
    return [f"    prop it: {'; '.join(said)}"] if said else []


def _lines(body: PosedModel, rows: list[dict[str, Any]]) -> list[str]:
    """Return one command for all joints that share base and bend, and the remaining joints."""
    said = []
    groups = dict[tuple[str, str | None], list[dict[str, Any]]]()
    for row in rows:
        if row["observable"]:
            groups.setdefault((row["base_pose"], row["with"]), []).append(row)
    for (base, bend), members in sorted(groups.items(), key=lambda each: (each[0][1] or "", each[0][0])):
        words = " ".join(each["joint"] for each in members)
        said.append(f"`twindctl calibrate prove --base {base}{f' --with {bend}' if bend else ''} {words}`")
        flips = ", ".join(f"{each['joint']} {each['flip_nm']:.2f}" for each in members)
        said += [f"    a wrong sign would be off by (N·m): {flips}", *_strain(body, base, bend)]
    rest = [each for each in rows if each["flip_nm"] is not None and not each["observable"]]
    if rest:
        said.append("unobservable: within friction whatever the pose, by your eye alone:")
        most = [f"{each['joint']} {each['flip_nm']:.2f}" for each in rest]
        said.append(f"    at most (N·m): {', '.join(most)}")
    beyond = [each["joint"] for each in rows if each["flip_nm"] is None]
    if beyond:
        said.append(f"not judged, turned by a transmission or without room: {', '.join(beyond)}")
    return said
