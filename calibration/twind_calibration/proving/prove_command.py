"""`twindctl calibrate prove`: moves one joint after the other through the daemon and evaluates its load."""

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import nan, radians
from typing import Any

import numpy as np

from twind.client import Client
from twind.command_line.progress import ProgressLine
from twind.command_line.verb import DONE, REFUSED, Rejected, UsageError, observer, operator
from twind.config.atomic_save import LockedFolder
from twind.config.calibration_file import Calibration, JointCalibration
from twind.config.robot_spec import JointSpec
from twind.ctl.hint_options import command_hint
from twind.ctl.instance_paths import restart
from twind.exceptions import InvalidInput
from twind.twin.base_pose import BASES
from twind_calibration.calibrating.calibration_context import CalibrationContext, ground, now
from twind_calibration.calibrating.calibration_steps import LEAST, MOST
from twind_calibration.calibrating.entry_writer import agreed, require_terminal
from twind_calibration.calibrating.file_ownership import lock_folder, save
from twind_calibration.proving.expected_loads import look_ahead, strained
from twind_calibration.proving.load_comparison import weigh
from twind_calibration.proving.proof_plan import print_plan
from twind_calibration.proving.proof_pose_motion import posed, wanted_pose
from twind_calibration.proving.proof_records import in_force, measurement_records, unlike, with_proofs
from twind_calibration.proving.proof_report import BLIND, ProofVerdict
from twind_calibration.proving.proof_sweep import ProofSweep, mean_loads, sweeps
from twind_calibration.rejection_hints import with_hints
from twind_calibration.wiggling.joint_move import (
    AROUND,
    MoveResult,
    allowed,
    go,
    goal_of,
    pose,
    print_note,
    require_amounts,
    require_armed,
    seen,
)
from twind_calibration.wiggling.move_evidence import EncoderObservation, EncoderResponse, answer
from twind_calibration.wiggling.posed_model import PosedModel
from twind_calibration.wiggling.state_trace import HoldMean
from twind_calibration.wiggling.state_trace import record_states as watched
from twind_drivers.clock import Clock, MonotonicClock


@with_hints
def prove(options: argparse.Namespace) -> int:
    """Return exit code 0: nothing contradicts. Raises Rejected, UsageError, ClientError."""
    require_amounts(options, LEAST, MOST)
    if options.plan:
        return print_plan(options)
    if options.base not in BASES:
        said = "how is the base held" if options.base is None else f"no base pose {options.base!r}"
        raise UsageError(f"{said}: say --base {', '.join(BASES)}; --plan says which proves what")
    return _prove(options)


def _prove(options: argparse.Namespace) -> int:
    with operator(options) as client:
        session = ProofSession(options, client, MonotonicClock())
        require_terminal(options)
        session.require_ready()
        verdicts: list[ProofVerdict] = []
        try:
            with posed(client, session.goals, take=options.take):
                for name in session.chosen:
                    verdicts.append(session.prove_joint(name))
                    if verdicts[-1].proof is None and not session.armed():
                        break  # what took the torque off, or latched, is told; the others would be refused
        except KeyboardInterrupt:  # the connection ends, and with it the lease
            print_note(options, "the robot holds where it is: `twindctl status --joints` says where")
            raise
        finally:
            session.keep(verdicts)
    done = {each.joint for each in verdicts if each.proof is not None}
    left = [name for name in session.chosen if name not in done]
    if not options.json:
        print(command_hint(options).prose(BLIND), flush=True)
        if left:
            print(f"not done, the same once more with: {' '.join(left)}", flush=True)
    return DONE if not left and all(each.is_consistent for each in verdicts) else REFUSED


class ProofSession:
    """State of robot and daemon while joints are proved."""

    def __init__(self, options: argparse.Namespace, client: Client, clock: Clock) -> None:
        self._options = options
        self._client = client
        self._clock = clock
        self._ground: CalibrationContext = ground(options, client)
        self.names = list(self._ground.robot.names)
        self.chosen = self._ground.select_actuators(options.joints, self.names)
        self.goals = wanted_pose(self._ground.robot, options.pose, options.bends)
        told = client.call("GetRobot")
        self._body = _body(self._ground, told["mjcf"], options.base)
        self._in_force = in_force(told["calibration"])
        self._entries = self._calibrated()

    def require_ready(self) -> None:
        """Check for mode live, armed, and the stated base. Raises Rejected, ClientError."""
        mode = self._client.call("GetStatus")["status"]["mode"]
        if mode != "live":
            raise Rejected(f"mode {mode}: only a robot that moves shows its load: `twindctl mode live`")
        held = f"{self._ground.robot.name} is held, {self._options.base}"
        if not agreed(self._options, f"{held}, and nothing is in its limbs' way?"):
            raise Rejected("nothing was moved")
        self._warn()
        require_armed(self._options, self._client)

    def _warn(self) -> None:
        """Print a warning about joints that carry a high load, with this base and in this pose."""
        there = pose(self._client, self.names)
        for name, angle in self.goals.items():
            there[self.names.index(name)] = angle
        if np.isfinite(there).all() and (said := strained(self._body, there)):
            print_note(self._options, f"held so, prop it: {'; '.join(said.values())}")

    def armed(self) -> bool:
        """Return whether the robot is still armed and no fault is latched."""
        status = self._client.call("GetStatus")["status"]
        return bool(status["armed"]) and not status["faults"]

    def prove_joint(self, name: str) -> ProofVerdict:
        """Sweep one joint, print and return the verdict."""
        verdict = self._measure_joint(name)
        if self._options.json:
            print(json.dumps(verdict.to_json(), ensure_ascii=False), flush=True)
        else:
            print(command_hint(self._options).prose("\n".join(verdict.lines())), flush=True)
        return verdict

    def keep(self, verdicts: Sequence[ProofVerdict]) -> None:
        """Write what was proved into the calibration file.

        Raises Rejected: it cannot be read or written, or holds another zero by now than what was proved.
        """
        if not verdicts:
            return
        own = {joint.name: joint.actuator for joint in self._ground.robot.joints if not joint.transmission}
        proofs = {own[each.joint]: each for each in verdicts if each.joint in own}
        with lock_folder(self._ground.path) as folder:
            before = self._ground.calibration()
            other = unlike(measurement_records(before), self._in_force)
            if before is not None:
                kept = {name: each for name, each in proofs.items() if name not in other}
                self._write(folder, *with_proofs(before, kept, now()))
        if lost := [name for name in proofs if name in other]:
            raise Rejected(
                f"{self._ground.path}: {', '.join(lost)} calibrated anew meanwhile: what was proved holds of "
                f"what it said before, and is not kept. {self._anew()}"
            )

    def _write(self, folder: LockedFolder, after: Calibration, new: list[str], gone: list[str]) -> None:
        if not new and not gone:
            return
        save(after, self._ground.path, folder)
        if self._options.json:
            print(json.dumps({"written": str(self._ground.path), "new": new, "gone": gone}), flush=True)
            return
        said = [f"proof of {', '.join(new)} written"] if new else []
        said += [f"earlier proof of {', '.join(gone)} taken away"] if gone else []
        print_note(self._options, f"{self._ground.path}: {'; '.join(said)}: `twindctl reload` takes it")

    def _calibrated(self) -> Mapping[str, JointCalibration]:
        """Return the entries by actuator.

        Raises Rejected: the daemon uses another calibration than the file.
        """
        file = self._ground.calibration()
        if names := unlike(measurement_records(file), self._in_force):
            raise Rejected(
                f"{self._ground.path} is not what the daemon goes by: {', '.join(names)} measured otherwise. "
                f"{self._anew()}"
            )
        return {} if file is None else file.by_name

    def _anew(self) -> str:
        return f"Restart the daemon (`{restart(self._options.socket)}`), then once more"

    def _measure_joint(self, name: str) -> ProofVerdict:
        place = self.names.index(name)
        joint = self._ground.robot.joints[place]
        who: dict[str, Any] = {
            "joint": name, "bus": joint.bus, "id": joint.id, "base": self._options.base, "names": self.names,
        }  # fmt: skip
        way, refused = self._way(joint)
        if way is None:
            return ProofVerdict(gone=MoveResult(nan, refused=refused), **who)
        entry = self._entries.get(joint.actuator)
        who["looks"] = self._looks(place, way, entry)
        gone, stays = self._sweep(place, way)
        if stays is None:
            motion = EncoderResponse.ENDED if gone.ended else EncoderResponse.UNHEARD
            return ProofVerdict(
                gone=gone, seen=EncoderObservation(motion, way.farthest, nan, nan, nan), **who
            )
        shown = mean_loads(way, stays)
        friction = float(self._options.friction)
        weighed = None if joint.transmission else weigh(self._body, place, shown, friction, entry)
        verdict = ProofVerdict(
            gone=gone, seen=answer(shown.ends, place, way.farthest), weighed=weighed, **who
        )
        if not verdict.open:
            return verdict
        return replace(verdict, confirmed=seen(self._options, name, verdict.looks))

    def _way(self, joint: JointSpec) -> tuple[ProofSweep | None, tuple[str, ...]]:
        """Return the first way that the gate permits, else the reason for its refusal."""
        home = goal_of(self._client, joint.name)
        if home is None:
            return None, ("its position is unknown: no reading arrived",)
        ways = sweeps(home, joint.lower, joint.upper, radians(self._options.degrees))
        if not ways:
            return None, ("its limits leave it no room to move",)
        at, refused = allowed(self._client, [way.path(joint.name) for way in ways])
        return (None if at is None else ways[at]), refused

    def _sweep(self, place: int, way: ProofSweep) -> tuple[MoveResult, list[HoldMean] | None]:
        """Return the result of the motion, and its stays; None: readings are missing."""
        name = self.names[place]
        with (
            observer(self._options) as watching,
            watched(watching, self.names) as trace,
            ProgressLine(self._options, name) as progress,
        ):
            self._move_to_rest()
            gone = go(
                self._client, self._clock, name, way.home, way.farthest,
                take=self._options.take, along=way.path(name), tell=progress.update,
            )  # fmt: skip
            self._move_to_rest()
        return gone, None if gone.ended or not gone.moved else trace.visits(place, way.visits)

    def _move_to_rest(self) -> None:
        self._clock.sleep_until(self._clock.now() + AROUND)

    def _looks(self, place: int, way: ProofSweep, entry: JointCalibration | None) -> str:
        """Return the expected visible motion, and print it before the joint moves; "" without a full pose.

        Also prints the deviation that a wrong sign would show (N·m); with --json nothing. The description is
        of a robot that stands.
        """
        there = pose(self._client, self.names)
        if not np.isfinite(there).all():
            return ""
        looks = self._body.looks_like(there, place, way.farthest)
        if not self._options.json:
            friction = float(self._options.friction)
            ahead = look_ahead(self._body, there, place, way.places, friction, entry)
            shows = f"a wrong sign would be {ahead.flip:.2f} N·m off"
            print_note(
                self._options, f"{self.names[place]}: {shows}; watch, as if it stood: {looks}, and back"
            )
        return looks


def _body(ground: CalibrationContext, mjcf: str, base: str) -> PosedModel:
    """Load the daemon's own model. Raises Rejected: the file on disk is another by now."""
    try:
        body = PosedModel(ground.robot, base)
    except InvalidInput as error:
        raise Rejected(str(error)) from None
    if mjcf != body.mjcf:
        raise Rejected(f"{ground.robot.mjcf_path} was changed since the daemon read it: restart the daemon")
    return body
