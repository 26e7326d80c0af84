"""`twindctl teleop` on a real terminal and a real daemon: whatever ends a held key ends the motion in time.

Measured from the event to the last change of the commanded position, as the daemon reports it.
"""

import contextlib
import os
import pty
import select
import signal
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.support.jog_rig import OVER, CommandedPosition
from tests.support.processes import Daemon, simulated, until
from twind.ctl.teleoperating.default_mapping import default_gamepad
from twind.ctl.teleoperating.teleop_session import TeleopSession
from twind.robot_client.robot import Robot

BOUND = 0.3  # s from the event to the last change of the goal
JOINT = "head_yaw"
PRESS = "\x1b[100u"  # of the key d, by the kitty protocol
RELEASE = "\x1b[100;1:3u"
MAPPING = f"""\
format: twind-teleop/1
keyboard:
  d: {{joint: {JOINT}, speed_rad_s: 0.2}}
  a: {{joint: {JOINT}, speed_rad_s: -0.2}}
  p: {{pose: arms_out}}
  w: {{motion: wave}}
  space: {{stop: true}}
"""


class TeleopTerminal:
    """A terminal with `twindctl teleop` on it, that answers as one with releases or one without."""

    def __init__(self, sockets: Path, mapping: Path, *, releases: bool) -> None:
        words = ["-m", "twind.ctl.ctl_main", "--socket", str(sockets), "teleop", "--mapping", str(mapping)]
        self.pid, self._fd = pty.fork()
        if self.pid == 0:
            os.execve(sys.executable, [sys.executable, *words], os.environ | {"TERM": "xterm-256color"})
        self._releases = releases
        self._answers = threading.Event()
        self._answers.set()
        self.shown = b""
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def type(self, text: str) -> None:
        """Send bytes of keys."""
        os.write(self._fd, text.encode())

    def freeze(self) -> None:
        """Read and answer no more."""
        self._answers.clear()

    def thaw(self) -> None:
        """Answer what was asked meanwhile."""
        self._answers.set()

    def close(self) -> None:
        """End the program by SIGTERM."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGTERM)
        self.wait()

    def wait(self) -> int:
        """Wait for its end; its exit code."""
        _, status = os.waitpid(self.pid, 0)
        self._thread.join(5.0)
        os.close(self._fd)
        return os.waitstatus_to_exitcode(status)

    def _run(self) -> None:
        while True:
            select.select([self._fd], [], [])
            self._answers.wait()
            try:
                data = os.read(self._fd, 4096)
            except OSError:
                return
            if not data:
                return
            self.shown += data
            if self._releases and b"\x1b[?u" in data:
                self.type("\x1b[?0u")
            if b"\x1b[c" in data:
                self.type("\x1b[?62;22c")
            self.type("\x1b[0n" * data.count(b"\x1b[5n"))


class Teleoperation:
    """A robot under a terminal, and the goal of its joint."""

    def __init__(self, daemon: Daemon, terminal: Any, goal: CommandedPosition) -> None:
        """`terminal`: a `TeleopTerminal`, or a `PipeGamepad`."""
        self.daemon = daemon
        self.terminal = terminal
        self.goal = goal

    def hold_stick(self) -> None:
        """Press the dead-man button of a gamepad and move its stick, until the robot moves."""
        for _ in range(5):
            for value in (0, 1):
                self.terminal.key("BTN_EAST", 0)
                self.terminal.axis("ABS_X", 32767 * value)
                self.terminal.key("BTN_TL", value)
                time.sleep(0.1)
            self.terminal.axis("ABS_X", 0)
            self.terminal.axis("ABS_X", 32767)
            time.sleep(0.5)
            if self.goal.is_moving():
                return
        raise AssertionError("the stick moves nothing")

    def hold(self, press: str) -> None:
        """Press until the robot moves; a busy machine may end a hold."""
        for _ in range(5):
            self.terminal.type(press)
            with contextlib.suppress(AssertionError):
                until(self.goal.is_moving, 3.0, "the joint moves")
                time.sleep(0.3)
                if self.goal.is_moving():
                    return
            self.terminal.type(RELEASE)
            time.sleep(0.3)
        raise AssertionError(self.terminal.shown.decode())


@contextmanager
def teleoperating(folder: Path, *, releases: bool) -> Iterator[Teleoperation]:
    mapping = folder / "mapping.yaml"
    mapping.write_text(MAPPING)
    with simulated(folder / "run") as running:
        terminal = TeleopTerminal(running.sockets, mapping, releases=releases)
        goal = CommandedPosition(running, JOINT)
        try:
            until(lambda: b"Ctrl-C ends" in terminal.shown, 30.0, lambda: terminal.shown.decode())
            yield Teleoperation(running, terminal, goal)
        finally:
            goal.close()
            terminal.close()


def test_a_held_key_moves_until_its_release_a_stop_a_frozen_terminal_or_a_lost_focus(tmp_path: Path) -> None:
    with teleoperating(tmp_path, releases=True) as rig:
        took = {}
        ends = {
            "released": lambda: rig.terminal.type(RELEASE),
            "stop key": lambda: rig.terminal.type("\x1b[32u"),
            "focus lost": lambda: rig.terminal.type("\x1b[O"),
            "terminal frozen": rig.terminal.freeze,
        }
        for name, end in ends.items():
            rig.hold(PRESS)
            took[name] = rig.goal.last_change_after(end, name)
            rig.terminal.thaw()
            rig.terminal.type(RELEASE + "\x1b[32;1:3u")
            time.sleep(0.2)
        rig.hold(PRESS)
        took["killed"] = rig.goal.last_change_after(
            lambda: os.kill(rig.terminal.pid, signal.SIGKILL), "killed"
        )
        assert max(took.values()) <= BOUND, took


def test_a_process_that_was_stopped_does_not_move_on(tmp_path: Path) -> None:
    with teleoperating(tmp_path, releases=True) as rig:
        rig.hold(PRESS)
        took = rig.goal.last_change_after(lambda: os.kill(rig.terminal.pid, signal.SIGSTOP), "SIGSTOP")
        os.kill(rig.terminal.pid, signal.SIGCONT)  # with the key still held
        still = rig.goal.last_change()
        time.sleep(OVER)
        assert took <= BOUND and rig.goal.last_change() == still


def test_without_releases_a_tap_is_a_short_step_and_repeats_move_on(tmp_path: Path) -> None:
    with teleoperating(tmp_path, releases=False) as rig:
        until(lambda: b"no releases" in rig.terminal.shown, 5.0, "the terminal is told")
        for _ in range(5):  # a terminal that answers too late moves nothing
            before = rig.goal.rows[-1][1]
            took = rig.goal.last_change_after(lambda: rig.terminal.type("d"), "tapped")
            step = rig.goal.rows[-1][1] - before
            if step:
                break
        print(f"a tap moved {step:.4f} rad")
        assert took <= BOUND and 0.0 < step <= 0.04

        end = time.monotonic() + 1.0
        while time.monotonic() < end:  # auto-repeat
            rig.terminal.type("d")
            time.sleep(0.033)
        assert rig.goal.rows[-1][1] - before > 0.1
        assert rig.goal.last_change_after(lambda: None, "repeats ended") <= BOUND


def test_a_pose_and_a_motion_run_while_their_key_is_held(tmp_path: Path) -> None:
    with (
        teleoperating(tmp_path, releases=True) as rig,
        closing(CommandedPosition(rig.daemon, "r_shoulder_roll")) as arm,
    ):
        for key, name in (("\x1b[112u", "pose"), ("\x1b[119u", "motion")):
            release = key.replace("u", ";1:3u")
            for _ in range(5):
                rig.terminal.type(release + key)
                with contextlib.suppress(AssertionError):
                    until(arm.is_moving, 3.0, name)
                    break
            at = time.monotonic()
            rig.terminal.type(release)
            time.sleep(1.0)
            took = arm.last_change() - at
            print(f"{name} released: the last change of the goal came {took * 1e3:.0f} ms after the event")
            assert -0.05 <= took <= BOUND, rig.terminal.shown.decode()
        assert rig.daemon.status()["motion"] == "holding"


def test_a_gamepad_moves_until_its_stick_its_dead_man_button_or_the_gamepad_is_gone(tmp_path: Path) -> None:
    pytest.importorskip("evdev", reason="no evdev on this machine: extra gamepad")
    from tests.support.gamepad_rig import PipeGamepad
    from twind.ctl.teleoperating.gamepad_input import GamepadInput

    pad = PipeGamepad()
    with (
        simulated(tmp_path) as running,
        Robot(str(running.sockets)) as robot,
        closing(GamepadInput(pad)) as controls,
        closing(CommandedPosition(running, robot.names[0])) as goal,
    ):
        with running.client() as client:
            description = client.call("GetRobot")["robot"]
        mapping = default_gamepad(description, controls.controls)
        controls.dead_man = mapping.dead_man
        session = TeleopSession(
            robot, description, mapping, controls, show=lambda _: None, tell=lambda _: None
        )
        ended = threading.Event()
        with ThreadPoolExecutor() as threads, ExitStack() as stack:
            stack.callback(ended.set)
            lost = threads.submit(session.run, ended)
            rig = Teleoperation(running, pad, goal)
            pad.axis("ABS_X", 32767)
            assert rig.goal.last_change_after(lambda: None, "the stick alone") < 0.0
            took = {}
            ends = {
                "stick released": lambda: pad.axis("ABS_X", 0),
                "dead-man released": lambda: pad.key("BTN_TL", 0),
                "stop button": lambda: pad.key("BTN_EAST", 1),
                "unplugged": pad.unplug,
            }
            for name, end in ends.items():
                rig.hold_stick()
                took[name] = rig.goal.last_change_after(end, name)
            with pytest.raises(EOFError, match="Test pad: unplugged"):
                lost.result(5.0)
    assert max(took.values()) <= BOUND, took


def test_a_wrong_mapping_ends_in_one_line(tmp_path: Path) -> None:
    mapping = tmp_path / "mapping.yaml"
    mapping.write_text(MAPPING.replace("0.2", "0.9", 1))
    with simulated(tmp_path / "run") as running:
        terminal = TeleopTerminal(running.sockets, mapping, releases=True)
        until(lambda: b"\n" in terminal.shown, 20.0, "a message")
        assert terminal.wait() == 2
    why = f"0.9 rad/s: use up to 0.2 rad/s ({JOINT}), and not 0"
    line = f"twindctl: {mapping}:3:37: keyboard.d.speed_rad_s: {why}"
    assert terminal.shown.decode().splitlines() == [line]
