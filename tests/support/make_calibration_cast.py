"""`make cast`: the calibration of a virtual robot as a person sees it, recorded from a real terminal.

Writes docs/calibration.cast and the transcript in calibration/README.md.
"""

import json
import os
import re
import shutil
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

from tests.support.terminal_cast import PROMPT, Terminal, load, rendered, save, shortened
from twind.config.robot_file import load_robot

ROOT = Path(__file__).parents[2]
CAST = ROOT / "docs" / "calibration.cast"
PAGE = ROOT / "calibration" / "README.md"
BEGIN = "<!-- shown by make cast -->\n```text\n"
END = "\n```\n"
WHOLE = ("24 of 24 swept", "24 of 24 joints", "armed: 24 joints", "succeeded at 100%", "disarmed")
JOB = re.compile(r"\[1\]")  # what the shell says of a program in the background: its number, its end
MOST = 4  # lines that one command may say in the transcript
FOLDER = Path("/tmp/h24")
QUICK = 3.0  # rad/s
LIMBS = ("head", "l_shoulder l_elbow", "r_shoulder r_elbow", "waist", "l_hip l_knee l_ankle", "r_")


def transcript() -> str:
    """Text of the recording on the screen, shortened and without the shell's own lines, for the page."""
    lines = [line for line in rendered(load(CAST)) if not JOB.match(line)]
    return "\n".join(shortened(lines, MOST)).strip()


def excerpt() -> str:
    """The part of the transcript that the page shows: sweep and zero."""
    shown = transcript().partition(f"\n{PROMPT}kill")[0]
    return shown[shown.index(f"{PROMPT}twindctl calibrate sweep") :]


def within(text: str) -> str:
    """The transcript that a page has. Raises ValueError: none."""
    begin = text.index(BEGIN) + len(BEGIN)
    return text[begin : text.index(END, begin)]


class Robot:
    """Virtual servos, and the hands that move them."""

    def __init__(self) -> None:
        shutil.rmtree(FOLDER, ignore_errors=True)
        FOLDER.mkdir()
        command = [sys.executable, "-m", "twind.virtual", "--robot", "h24", "--muscles", "first-order"]
        command += ["--truth-seed", "11", "--link", str(FOLDER), "--faults", str(FOLDER / "faults")]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        while self._process.stdout.readline() != "ready\n":
            assert self._process.poll() is None

    def order(self, **order: Any) -> None:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
            client.connect(str(FOLDER / "faults"))
            client.sendall(json.dumps(order).encode() + b"\n")
            assert json.loads(client.recv(1 << 16)).get("ok"), order

    def sweep(self) -> None:
        """Limb by limb to both ends of every joint, half a second at each."""
        left = list(load_robot("h24").joints)
        for limb in LIMBS:
            own = [joint for joint in left if joint.name.startswith(tuple(limb.split()))]
            left = [joint for joint in left if joint not in own]
            for side, beyond in (("lower", -1.0), ("upper", 1.0)):
                pose = {joint.name: getattr(joint, side) + beyond for joint in own}
                self.order(fault="hand", pose=pose, speed=QUICK)
                time.sleep(1.0 + max(joint.upper - joint.lower for joint in own) / QUICK)

    def stand(self) -> None:
        """Every joint at 0."""
        pose = dict.fromkeys(load_robot("h24").names, 0.0)
        self.order(fault="hand", pose=pose, speed=QUICK)

    def restart(self) -> None:
        """Let go, and its power off and on: in position mode a servo that is turns off gets no torque."""
        self.order(fault="hand", off=True)
        for on in (False, True):
            self.order(fault="power", on=on)
            time.sleep(1.0)

    def close(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(10.0)
        shutil.rmtree(FOLDER, ignore_errors=True)


def play(robot: Robot, terminal: Terminal) -> None:
    """The whole way, as a person goes it."""
    daemon = "twind --mode {} --robot h24 --port ./main --socket run/twind 2>>twind.log &"
    terminal.run(daemon.format("mirror"))
    time.sleep(2.0)
    terminal.run("twindctl calibrate scan")
    mover = threading.Timer(2.5, robot.sweep)
    mover.start()
    terminal.run("twindctl calibrate sweep", 120.0)
    mover.join()
    robot.stand()
    terminal.type("twindctl calibrate zero")
    terminal.until("when it stands ")
    time.sleep(3.0)
    terminal.type("")
    terminal.until("[y/N] ")
    terminal.type("y")
    terminal.until("\n$ ")
    terminal.run("kill %1; wait")
    robot.restart()
    terminal.run(daemon.format("live"))
    time.sleep(2.0)
    for command in ("arm", "move l_knee=0.5", "status", "disarm"):
        terminal.run(f"twindctl {command}")
    terminal.run("kill %1; wait")


def main() -> int:
    """Record, write both files."""
    robot = Robot()
    runtime = FOLDER / "run"
    runtime.mkdir()
    places = {"XDG_RUNTIME_DIR": str(runtime), "STATE_DIRECTORY": str(FOLDER / "state")}
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    try:
        terminal = Terminal({**os.environ, **places, "PATH": path}, FOLDER)
        try:
            play(robot, terminal)
        finally:
            terminal.close()
    finally:
        robot.close()
    shown = "".join(text for _, text in terminal.events)
    missing = [said for said in WHOLE if said not in shown]
    if missing:  # a machine that is busy loses answers of the virtual servos, and a motion ends
        print(f"nothing was written: the recording does not say {', '.join(missing)}; try again")
        return 1
    save(CAST, terminal.events, "twind: the calibration of a robot")
    page = PAGE.read_text()
    begin = page.index(BEGIN) + len(BEGIN)
    PAGE.write_text(page[:begin] + excerpt() + page[page.index(END, begin) :])
    return 0


if __name__ == "__main__":
    sys.exit(main())
