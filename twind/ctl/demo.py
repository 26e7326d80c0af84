"""Run a virtual robot: the daemon, a motion and a refusal.

Starts its own daemon on its own sockets and ends it, so it can never reach a real robot.
"""

import argparse
import ctypes
import math
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from types import FrameType
from typing import Any

from twind import robots
from twind.client import Client, ClientError, Refused
from twind.client.errors import finding_lines
from twind.command_line.extras import how_to_add
from twind.command_line.trajectory_files import load_motion, motion_names
from twind.command_line.verb import DONE, Rejected, UsageError
from twind.ctl.demo_viewer import viewer
from twind.ctl.status_table import latency_text, loop_text

group = "see"
unused_options = ("--socket", "--json")  # it asks no daemon

START = 30.0  # s the daemon may take until its robot is connected
TRIES = 3  # of one motion
ARMING = 15.0  # s of refusals: the first run after an installation compiles what it imports, and reads late
AGAIN = 0.5  # s between two tries: by then every slow register was read once more
LOWERING = 5.0  # s kept for the way to the rest pose
BEYOND = 0.5  # rad above a joint's limit, of the trajectory that is refused
WALKER = "h24-standing"
SPEED = "0.12,0,0"
LETTING_GO = 2.0  # s until the virtual robot's support has let go of it
Motions = Mapping[str, Mapping[str, Any]]  # trajectories by name


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("--seconds", type=float, help="end by itself after so long (default: until Ctrl-C)")
    robot = parser.add_mutually_exclusive_group()
    robot.add_argument("--robot", default="h24", help="built-in robot or robot file (default h24)")
    robot.add_argument(
        "--walk", action="store_true", help=f"{WALKER} walks by its trained policy; needs the extra policy"
    )


def run(options: argparse.Namespace) -> int:
    """Show it. Exit code 0 when everything was shown and the robot was lowered."""
    if options.seconds is not None and not options.seconds > 0.0:
        raise UsageError(f"--seconds {options.seconds:g} must be positive")
    for number in (signal.SIGTERM, signal.SIGHUP):  # a closed terminal lowers the robot as Ctrl-C does
        signal.signal(number, _interrupt)
    if options.walk and find_spec("onnxruntime") is None:
        raise UsageError(f"--walk needs onnxruntime: {how_to_add('policy')}")
    robot = WALKER if options.walk else options.robot
    _require_robot(robot)
    until = None if options.seconds is None else time.monotonic() + options.seconds
    with (
        tempfile.TemporaryDirectory(prefix="twind-demo-") as folder,
        viewer(folder, _end_with_us),
        _daemon(folder, robot) as daemon,
    ):
        _await_robot(folder, daemon)
        with Client(folder) as client:
            try:
                if options.walk:
                    _walk(client, folder, options.seconds)
                else:
                    _show_motions(client, folder, until)
            except KeyboardInterrupt:
                print("\nCtrl-C: lowering the robot")
        _lower(folder)
    print("done      torque is off, the daemon has ended")
    return DONE


def _require_robot(name: str) -> None:
    """Read the robot before anything is started. Raises Rejected."""
    from twind.config.daemon_settings import load_settings
    from twind.config.robot_file import load_robot
    from twind.config.yaml_tree import ConfigError

    try:
        load_robot(name, load_settings(None).robot_folders)
    except ConfigError as error:
        raise Rejected(str(error)) from None


def _show_motions(client: Client, folder: str, until: float | None) -> None:
    robot = client.call("GetRobot")["robot"]
    motions = load_motions(robot)
    _show(client, folder, robot, motions)
    if until is None:
        _stay(folder, client, motions)
    else:
        _play_until(client, folder, motions, until)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _end_with_us() -> None:
    """In the child, before exec: SIGTERM when this process goes, however it goes (prctl(2))."""
    ctypes.CDLL(None).prctl(1, signal.SIGTERM, 0, 0, 0)


@contextmanager
def _daemon(folder: str, robot: str) -> Iterator["subprocess.Popen[bytes]"]:
    """A `twind --virtual --mode live` of our own; ended by SIGTERM, which lowers the robot."""
    log = Path(folder) / "twind.log"
    command = [sys.executable, "-m", "twind.cli", "--virtual", "--mode", "live"]
    command += ["--robot", robot, "--socket", folder]
    print(f"starting  twind --virtual --mode live --robot {robot}")
    with log.open("wb") as output:
        daemon = subprocess.Popen(
            command,
            stderr=output,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
            preexec_fn=_end_with_us,
        )
    try:
        yield daemon
    except Rejected:
        sys.stderr.write(log.read_text(errors="replace"))
        raise
    finally:
        daemon.send_signal(signal.SIGTERM)
        try:
            daemon.wait(20.0)
        except subprocess.TimeoutExpired:
            daemon.kill()
            daemon.wait()
    if daemon.returncode != 0:
        sys.stderr.write(log.read_text(errors="replace"))
        raise Rejected(f"the daemon ended with {daemon.returncode}")


def _await_robot(folder: str, daemon: "subprocess.Popen[bytes]") -> None:
    deadline = time.monotonic() + START
    state = "starting"
    while time.monotonic() < deadline:
        if daemon.poll() is not None:
            raise Rejected(f"the daemon did not start: it ended with {daemon.returncode}")
        try:
            with Client(folder) as client:
                status = client.call("GetStatus")["status"]
                state = status["state"]
                if state == "connected":
                    for bus in status["buses"]:
                        print(f"bus       {bus['name']} on {bus['port']}: every servo identified")
                    return
        except ClientError:
            pass
        time.sleep(0.1)
    raise Rejected(f"the robot was not connected within {START:g} s (it is {state})")


@dataclass
class TrackingErrorMeter:
    """|goal - measured| of every joint while a motion runs, from the topic `state`."""

    worst: float = 0.0  # rad
    joint: str = ""
    squares: float = 0.0
    count: int = 0
    ended: threading.Event = field(default_factory=threading.Event)

    def take(self, joints: list[dict[str, Any]]) -> None:
        """One reading of all joints."""
        for joint in joints:
            if joint.get("goal") is None or joint.get("position") is None:
                continue
            error = abs(joint["goal"] - joint["position"])
            self.squares = self.squares + error * error
            self.count = self.count + 1
            if error > self.worst:
                self.worst = error
                self.joint = joint["name"]

    def text(self) -> str:
        """For people."""
        rms = math.sqrt(self.squares / self.count) if self.count else math.nan
        return f"tracking error rms {rms:.4f} rad, worst {self.worst:.4f} rad ({self.joint})"


@contextmanager
def _tracked(folder: str) -> Iterator[TrackingErrorMeter]:
    tracking = TrackingErrorMeter()

    def watch() -> None:
        with Client(folder) as client:
            for news in client.stream("Monitor", topics=["state"], rate=100.0):
                if tracking.ended.is_set():
                    return
                tracking.take(news["joints"])

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield tracking
    finally:
        tracking.ended.set()
        thread.join(2.0)


def load_motions(robot: Mapping[str, Any]) -> Motions:
    """Return the trajectories in the robot's own folder, by name. Raises Rejected where there are none."""
    folder = Path(robot["motions"])
    found = {name: load_motion(name, folder) for name in motion_names(folder)}
    if not found:
        raise Rejected(f"no motion to show: {folder} holds no trajectory file (*.json); add one")
    return found


def _show(client: Client, folder: str, robot: Mapping[str, Any], motions: Motions) -> None:
    """Show arming, a motion, a refusal and the latency."""
    joints = arm_robot(client)
    print(f"armed     {len(joints)} joints hold where they were found")
    _play(client, folder, next(iter(motions)), motions)
    _refusal(client, robot)
    _latency(client)


def _walk(client: Client, folder: str, seconds: float | None) -> None:
    """Let the trained policy drive, by the verb that drives any robot. Raises Rejected: it ended early."""
    arm_robot(client)
    time.sleep(LETTING_GO)
    client.call("ReleaseLease")
    command = [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", folder, "policy", "run"]
    command += [str(Path(robots.__file__).with_name(f"{WALKER}.walk.onnx")), "--command", SPEED]
    command += [] if seconds is None else ["--seconds", str(seconds)]
    print(f"walks     by its policy, commanded {SPEED} (m/s forward, m/s left, rad/s)")
    policy = subprocess.Popen(command, stdin=subprocess.DEVNULL, preexec_fn=_end_with_us)
    try:
        if policy.wait() != 0:
            raise Rejected("the policy ended early; on a busy machine it has no time for every period")
    finally:
        if policy.poll() is None:
            policy.send_signal(signal.SIGINT)
            policy.wait(5.0)


def arm_robot(client: Client) -> list[Any]:
    """Arm, and return the joints; a refusal is tried again for ARMING s. Raises Refused."""
    deadline = time.monotonic() + ARMING
    while True:
        client.call("AcquireLease")
        try:
            return list(client.call("Arm")["joints"])
        except Refused as error:
            if time.monotonic() >= deadline:
                raise
            print("\n".join(finding_lines(error.findings, "waiting   ")[:1]))
            time.sleep(AGAIN)


def _play_until(client: Client, folder: str, motions: Motions, until: float) -> None:
    """Motions in turn as long as one fits."""
    turn = 1
    while fitting := [name for name, motion in motions.items() if _has_time_for(motion, until)]:
        _play(client, folder, fitting[turn % len(fitting)], motions)
        turn += 1


def _has_time_for(motion: Mapping[str, Any], until: float) -> bool:
    return time.monotonic() + duration(motion) + LOWERING <= until


def _stay(folder: str, client: Client, motions: Motions) -> None:
    """Motions in turn behind the live picture of `twindctl monitor`, until q or Ctrl-C."""
    from twind.ctl.dashboard.live_dashboard import show  # rich: only who stays to look needs it

    ended = threading.Event()
    player = threading.Thread(target=_keep_playing, args=(client, motions, ended), daemon=True)
    player.start()
    try:
        show(lambda: Client(folder, name="observe"), 5.0)
    finally:
        ended.set()
        with Client(folder) as other:
            other.call("Cancel")  # needs no lease; the player's stream ends with it
        player.join(5.0)


def _keep_playing(client: Client, motions: Motions, ended: threading.Event) -> None:
    paths = list(motions.values())
    for turn in range(1, 1_000_000):
        if ended.is_set():
            return
        client.call("AcquireLease")
        for _ in client.stream("SubmitTrajectory", trajectory=paths[turn % len(paths)]):
            pass
        ended.wait(0.3)


def duration(motion: Mapping[str, Any]) -> float:
    """Return the duration of a trajectory, s."""
    return float(motion["points"][-1]["time_from_start"])


def _play(client: Client, folder: str, name: str, motions: Motions) -> None:
    """Play one motion to its end; try again if the daemon holds because the machine is too busy."""
    motion = motions[name]
    for _ in range(TRIES):
        client.call("AcquireLease")
        with _tracked(folder) as tracking:
            last = list(client.stream("SubmitTrajectory", trajectory=motion))[-1]
        if last["phase"] == "succeeded":
            print(f"played    {name}: {tracking.text()}")
            return
        why = f"this machine kept the daemon waiting: {folder}/twind.log"
        print(f"held      {name}: ended {last['phase']}; {why}")
        _go_to_start(client, motion)
    raise Rejected(f"motion {name} did not come to its end in {TRIES} tries")


def _go_to_start(client: Client, motion: Mapping[str, Any]) -> None:
    """Slowly back to where the motion begins."""
    first = {"positions": motion["points"][0]["positions"], "time_from_start": 3.0}
    path = {"joint_names": motion["joint_names"], "points": [first], "policy": "retime"}
    for _ in client.stream("SubmitTrajectory", trajectory=path):
        pass


def _refusal(client: Client, robot: Mapping[str, Any]) -> None:
    """A trajectory beyond a joint's limit: the gate must refuse it, and say why."""
    joint = robot["joints"][0]
    points = [{"positions": [joint["upper"] + BEYOND], "time_from_start": 2.0}]
    bad = {"joint_names": [joint["name"]], "points": points}
    try:
        client.call("SubmitTrajectory", trajectory=bad)
    except Refused as refusal:
        print("\n".join(finding_lines(refusal.findings, "refused  ")))
        return
    raise Rejected("a trajectory beyond the limits was accepted")


def _latency(client: Client) -> None:
    status = client.call("GetStatus")["status"]
    print(f"latency   {latency_text(status)}")
    print(f"loop      {loop_text(status['loop'])}")


def _lower(folder: str) -> None:
    with Client(folder) as client:
        state = client.call("Disarm")["state"]
    print(f"lowered   to the rest pose, torque off, state {state}")
