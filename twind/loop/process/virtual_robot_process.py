"""`--virtual`: a `twind-virtual` of the same robot as a child process with its own calibration.

It never touches a real robot's files. It ends with the daemon: its standard input is a pipe of the daemon.
"""

import select
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from types import TracebackType

from twind.config.daemon_settings import VIRTUAL_FOLDER
from twind.exceptions import OperationFailed
from twind.loop.bus.bus_port import Opener
from twind.loop.ipc.child_process import child_environment
from twind_drivers.bus import BusReader, PortError

START = 30.0  # s it may take to be ready


class VirtualRobotProcess:
    """Context manager: the virtual robot is ready inside, and ended outside. `ports` by bus name."""

    def __init__(self, robot: str, *options: str) -> None:
        """`options`: for `twind-virtual`, besides its robot and its files."""
        self._folder = tempfile.TemporaryDirectory(prefix=VIRTUAL_FOLDER)
        self.calibration = Path(self._folder.name) / "calibration.yaml"
        self.faults = Path(self._folder.name) / "faults.sock"
        self.ports: dict[str, str] = {}
        self.power: dict[str, str] = {}  # ports of relay and stop button
        # -P: no module of the folder that the daemon happened to be started in.
        command = [sys.executable, "-P", "-m", "twind.virtual", "--robot", robot]
        command += ["--calibration", str(self.calibration), "--faults", str(self.faults), *options]
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
            env=child_environment(),
        )

    def __enter__(self) -> "VirtualRobotProcess":
        try:
            self._await_ready()
        except BaseException:
            self.close()
            raise
        return self

    def _await_ready(self) -> None:
        output = self._process.stdout
        assert output is not None
        text = b""
        while not text.endswith(b"ready\n"):
            ready, _, _ = select.select([output], [], [], START)
            more = output.read1(4096) if ready else b""  # type: ignore[attr-defined]
            if not more:
                raise OperationFailed("the virtual robot did not start; its own messages are above")
            text += more
        for line in text.decode().splitlines():
            word, _, rest = line.partition(" ")
            name, _, path = rest.partition(" ")
            if word == "bus":
                self.ports[name] = path
            elif word == "power":
                self.power[name] = path

    def guarded(self, opener: Opener) -> Opener:
        """Return an opener of its buses that raises PortError once the virtual robot has ended.

        Another program may have its pseudo-terminals by then.
        """

        def open_bus(name: str) -> BusReader:
            code = self._process.poll()
            if code is not None:
                ended = f"the virtual robot has ended (exit code {code}), its own messages say why"
                raise PortError(self.ports[name], f"{ended}: start `twind --virtual` again")
            return opener(name)

        return open_bus

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End it: end-of-file on its input, then a wait, then SIGKILL."""
        with suppress(OSError):
            if self._process.stdin is not None:
                self._process.stdin.close()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._folder.cleanup()
