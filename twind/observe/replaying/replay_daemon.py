"""A daemon of a replay's own: files of the recording, ports on pseudo-terminals, sockets in a folder."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from twind.client import NoDaemon
from twind.config.port_names import Medium, virtual_port
from twind.exceptions import OperationFailed
from twind.observe.replaying import exec_with_priority
from twind.observe.replaying.replay_calls import ReplayConnection
from twind.observe.replaying.replay_files import ReplayFiles

START = 60.0  # s until its sockets are there
# s that it may take to end after SIGTERM, and after SIGKILL
SOON = 0.5
END = 10.0
WORDS = 2000  # characters of its log that are reported
OURS = ("LISTEN_", "NOTIFY_", "WATCHDOG_", "STATE_DIRECTORY", "XDG_")  # of the environment: not for it


class ReplayDaemon:
    """Context manager: it listens in `sockets` inside, and is gone outside."""

    def __init__(
        self,
        files: ReplayFiles,
        mode: str,
        ports: Mapping[str, Path],
        sockets: Path,
        *,
        realtime: bool,
    ) -> None:
        """Every bus of the robot has its port here, so that none of the robot file's is ever opened.

        `realtime`: before the ordinary programs of this machine, after the daemon of a robot.
        """
        self.sockets = sockets
        self._log = sockets / "log"
        # -P: no module of the folder that this happened to be started in.
        python = [sys.executable, "-P", "-m"]
        rank = str(exec_with_priority.DAEMON if realtime else 0)
        command = [
            *python,
            exec_with_priority.__name__,
            rank,
            *python,
            "twind.cli",
            "--config",
            str(files.config),
        ]
        command += ["--mode", mode]
        command += ["--robot", str(files.robot), "--socket", str(sockets)]
        command += [] if files.calibration is None else ["--calibration", str(files.calibration)]
        for name, path in ports.items():
            command += ["--port", f"{name}={virtual_port(Medium.SERIAL, str(path))}"]
        mine = {key: value for key, value in os.environ.items() if not key.startswith(OURS)}
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=mine, start_new_session=True
            )

    def __enter__(self) -> "ReplayDaemon":
        try:
            self._await()
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    @property
    def words(self) -> str:
        """The end of its log."""
        return self._log.read_text(errors="replace")[-WORDS:].strip()

    def _await(self) -> None:
        deadline = time.monotonic() + START
        while not self._listens():
            if self._process.poll() is not None or time.monotonic() > deadline:
                raise OperationFailed(f"the daemon did not start: {self.words}")
            time.sleep(0.02)

    def _listens(self) -> bool:
        try:
            ReplayConnection(self.sockets / "observe.sock").close()
        except NoDaemon:
            return False
        return True

    def _end(self) -> None:
        """A robot that has torque would be lowered first, which takes as long as it takes: it is no robot."""
        front = self._children()
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)
        try:
            self._process.wait(SOON)
        except subprocess.TimeoutExpired:
            for child in front:  # or it would write down what the daemon held when it was killed
                with suppress(ProcessLookupError):
                    os.kill(child, signal.SIGKILL)
            self._process.kill()
            self._process.wait(END)

    def _children(self) -> list[int]:
        """Processes that it has started."""
        pid = self._process.pid
        try:
            return [int(each) for each in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
        except OSError:
            return []
