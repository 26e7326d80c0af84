"""`twindctl wiggle`: moves one joint after the other through the daemon, and reports the measurements."""

import argparse
import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from math import isfinite, nan, radians
from pathlib import Path
from typing import Any

import numpy as np

from twind.client import Client
from twind.command_line.verb import DONE, REFUSED, UsageError, observer, operator
from twind.config.robot_file import read_robot
from twind.config.yaml_tree import ConfigError
from twind.ctl.hint_options import command_hint
from twind.exceptions import InvalidInput
from twind_calibration.rejection_hints import unknown_joint, with_hints
from twind_calibration.wiggling.joint_move import (
    AROUND,
    MoveResult,
    direction,
    go,
    goal_of,
    pose,
    print_note,
    require_armed,
    seen,
)
from twind_calibration.wiggling.move_evidence import (
    EncoderObservation,
    EncoderResponse,
    TorqueObservation,
    alike,
    answer,
    weigh,
)
from twind_calibration.wiggling.posed_model import PosedModel
from twind_calibration.wiggling.state_trace import MoveHolds, record_states
from twind_calibration.wiggling.wiggle_report import BLIND, NOT_COMPARED, WiggleVerdict
from twind_drivers.clock import Clock, MonotonicClock


@with_hints
def wiggle(options: argparse.Namespace) -> int:
    """Return exit code 0 if nothing contradicts the files. Raises Rejected, UsageError, ClientError."""
    if options.all == bool(options.joints):
        raise UsageError("name JOINTs, or --all of them")
    return _wiggle(options)


def _wiggle(options: argparse.Namespace) -> int:
    with operator(options) as client:
        session = WiggleSession(options, client, MonotonicClock())
        session.require_ready()
        try:
            good = [session.wiggle_joint(name) for name in session.chosen]
        except KeyboardInterrupt:  # the connection ends, and with it the lease
            print_note(options, "the robot holds where it is: `twindctl status --joints` says where")
            raise
        session.close()
    return DONE if all(good) else REFUSED


class WiggleSession:
    """State of robot and daemon while joints are wiggled."""

    def __init__(self, options: argparse.Namespace, client: Client, clock: Clock) -> None:
        self._options = options
        self._client = client
        self._clock = clock
        self._robot: Mapping[str, Any] = client.call("GetRobot")["robot"]
        self.names: list[str] = [joint["name"] for joint in self._robot["joints"]]
        self.mode: str = client.call("GetStatus")["status"]["mode"]
        self.chosen = self._select_joints(options.joints)
        self._body, self._why = read_body(self._robot)

    def require_ready(self) -> None:
        """Check that the robot is armed, in mode live. Raises Rejected, ClientError."""
        if self._options.json:
            pass
        elif self.mode != "live":
            print_note(self._options, f"mode {self.mode}: {NOT_COMPARED}")
        elif self._why:
            print_note(self._options, f"loads are not compared: {self._why}")
        if self.mode == "live":
            require_armed(self._options, self._client)

    def wiggle_joint(self, name: str) -> bool:
        """Move one joint and print the result; return whether nothing contradicts."""
        verdict = self._measure_joint(name)
        if self._options.json:
            print(json.dumps(verdict.to_json(), ensure_ascii=False), flush=True)
        else:
            print(command_hint(self._options).prose("\n".join(verdict.lines())), flush=True)
        return verdict.is_consistent

    def close(self) -> None:
        """Print the closing notes: the limits of the test, and that the robot stays armed."""
        if self._options.json or self.mode != "live":
            return
        print(BLIND, flush=True)
        if self._options.arm:
            print_note(
                self._options, "the robot stays armed: `twindctl disarm` lowers it and takes its torque off"
            )

    def _measure_joint(self, name: str) -> WiggleVerdict:
        place = self.names.index(name)
        joint = self._robot["joints"][place]
        who = {"joint": name, "bus": joint["bus"], "id": joint["id"], "names": self.names}
        home = goal_of(self._client, name)
        if home is None:
            return WiggleVerdict(
                gone=MoveResult(nan, refused=("its position is unknown: no reading arrived",)), **who
            )
        gone = direction(self._client, name, home, radians(self._options.degrees))
        if not gone.moved:
            return WiggleVerdict(gone=gone, **who)
        looks = self._looks(place, gone.way)
        if self.mode != "live":
            gone = self._go(name, home, gone.way)
            return WiggleVerdict(gone=gone, seen=_unseen(EncoderResponse.SIMULATED, gone), looks=looks, **who)
        with observer(self._options) as watching, record_states(watching, self.names) as trace:
            self._move_to_rest()
            gone = self._go(name, home, gone.way)
            self._move_to_rest()
        if not gone.moved or gone.ended:
            return WiggleVerdict(gone=gone, seen=_unseen(EncoderResponse.ENDED, gone), looks=looks, **who)
        stays = trace.stays(place, home, home + gone.way)
        answered = answer(stays, place, gone.way)
        weighed = self._compare_load(stays, place)
        return WiggleVerdict(
            gone=gone,
            seen=answered,
            weighed=weighed,
            looks=looks,
            confirmed=seen(self._options, name, looks),
            **who,
        )

    def _go(self, name: str, home: float, way: float) -> MoveResult:
        return go(self._client, self._clock, name, home, way, take=self._options.take)

    def _move_to_rest(self) -> None:
        self._clock.sleep_until(self._clock.now() + AROUND)

    def _compare_load(self, stays: MoveHolds | None, place: int) -> TorqueObservation | None:
        """The mean of the stays on both ends: friction has another sign on the way there and home."""
        body = self._body
        friction = float(self._options.friction)
        if body is None or stays is None or body.stands_on(place):
            return None
        both = (stays.out, stays.home)
        poses = [stay.position for stay in both]
        if not all(np.isfinite(pose).all() for pose in poses):
            return None

        def mean(values: Sequence[float]) -> float:
            return float(np.mean(values))

        measured = mean([float(stay.effort[place]) for stay in both])
        model = mean([float(body.torque(pose)[place]) for pose in poses])
        flipped = mean([body.turned_round(pose, place) for pose in poses])
        found = weigh(measured, model, flipped, friction)
        others = body.twins(place) if isfinite(measured) else []
        there = [mean([body.load_if_exchanged(pose, place, other) for pose in poses]) for other in others]
        like = tuple(others[each] for each in alike(measured, model, there, friction))
        return TorqueObservation(found.load, measured, model, flipped, like)

    def _looks(self, place: int, way: float) -> str:
        """Return the expected visible motion, and print it before the joint moves; "" where it is unknown."""
        position = pose(self._client, self.names)
        if self._body is None or not np.isfinite(position).all():
            return ""
        looks = self._body.looks_like(position, place, way)
        if not self._options.json and self.mode == "live":
            print_note(self._options, f"{self.names[place]}: watch: {looks}, and back")
        return looks

    def _select_joints(self, joints: Sequence[str]) -> list[str]:
        for name in joints:
            if name not in self.names:
                raise unknown_joint(self._robot["name"], name, self.names)
        return list(dict.fromkeys(joints)) if joints else self.names


def read_body(description: Mapping[str, Any]) -> tuple[PosedModel | None, str]:
    """The model of the daemon's robot, by the file that the daemon read; else why there is none."""
    with suppress(KeyError, TypeError):
        try:
            robot = read_robot(Path(description["path"]))
            if robot.text_sha256 != description["text_sha256"]:
                return None, f"{robot.path} was changed since the daemon read it"
            return PosedModel(robot), ""
        except (ConfigError, InvalidInput) as error:
            return None, str(error)
    return None, "the daemon does not say which robot file it read"


def _unseen(motion: EncoderResponse, gone: MoveResult) -> EncoderObservation | None:
    """Return the observation of a move without measurement; None: there was no move."""
    return EncoderObservation(motion, gone.way, nan, nan, nan) if gone.moved else None
