"""A daemon in sim, a router and an uplink, each a process; and a peer far away that knows the keys alone."""

import json
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zenoh

from tests.support.processes import Daemon, until
from tests.support.zenoh_router import Router
from twind.bridge.zenoh.zenoh_session import NetworkConfig, open_now

PATIENCE = 30.0  # s that a busy machine may take
JOINT = "l_knee"


class Uplink:
    """A `twindctl uplink` beside the daemon of these sockets. Whoever begins it ends it: `gone`."""

    def __init__(
        self, sockets: Path, *words: str, program: Sequence[str] = ("-m", "twind.ctl.ctl_main")
    ) -> None:
        command = [sys.executable, *program, "--json", "--socket", str(sockets), "uplink", *words]
        self._log = tempfile.TemporaryFile("w+")  # noqa: SIM115  as long as the process
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=self._log, text=True)

    @property
    def output(self) -> str:
        """All of it so far."""
        self._log.seek(0)
        return self._log.read()

    def end(self) -> tuple[int, str]:
        """Told to stop: its exit code, and what it printed."""
        if self.process.poll() is None:
            self.process.terminate()
        out, _ = self.process.communicate(timeout=PATIENCE)
        return self.process.returncode, out

    def gone(self) -> None:
        """End it at once, if it has not ended."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait(PATIENCE)
        if self.process.stdout is not None:
            self.process.stdout.close()
        self._log.close()


class Far:
    """Somebody elsewhere: a session with the router, and no word of our code but where it opens sessions."""

    def __init__(self, place: NetworkConfig, robot: str) -> None:
        self.robot = robot
        self.session = open_now(place, PATIENCE)
        self._open: list[Any] = []

    def close(self) -> None:
        self.session.close()

    def key(self, *parts: str) -> str:
        return "/".join(("twind", self.robot, *parts))

    def there(self) -> bool:
        """Its token is alive."""
        return any(reply.ok for reply in self.session.liveliness().get(self.key("alive"), timeout=5.0))

    def ask(self, *parts: str, data: bytes | None = None, **asked: Any) -> dict[str, Any]:
        """The answer, or the error {"error", "parameters"}; {}: nobody answered."""
        payload = json.dumps(asked).encode() if data is None else data
        for reply in self.session.get(self.key(*parts), payload=payload, timeout=PATIENCE):
            told = reply.ok or reply.err
            assert told is not None
            answer: dict[str, Any] = json.loads(told.payload.to_bytes())
            return answer
        return {}

    def listen(self, *parts: str) -> list[bytes]:
        """A list that grows by every payload."""
        heard: list[bytes] = []
        key = self.key(*parts)
        self._open.append(self.session.declare_subscriber(key, lambda s: heard.append(s.payload.to_bytes())))
        return heard

    def deaf(self) -> None:
        """Listen to nothing any more."""
        while self._open:
            self._open.pop().undeclare()

    def lease(self, holder: str = "test", **more: Any) -> dict[str, Any]:
        """A grant, or the error. `more`: take, deadline."""
        return self.ask("lease", op="acquire", holder=holder, **more)

    @contextmanager
    def holding(self) -> Iterator[str]:
        """A lease that is renewed until the end, and then given back; its token."""
        grant = until(lambda: self.lease().get("lease"), PATIENCE, "a lease")
        stop = threading.Event()

        def renew() -> None:
            while not stop.wait(0.2):
                self.ask("lease", op="renew", lease=grant)

        thread = threading.Thread(target=renew)
        thread.start()
        try:
            yield grant
        finally:
            stop.set()
            thread.join()
            self.ask("lease", op="release", lease=grant)

    def goal(
        self, name: str, lease: str, to: float, seconds: float, *, ahead: float = 10.0, **more: Any
    ) -> dict[str, Any]:
        """Send the knee somewhere within so long. The robot's clock is this machine's."""
        point = {"positions": [to], "velocities": [0.0], "time_from_start": seconds}
        path = {"joint_names": [JOINT], "points": [point], **more}
        deadline = time.clock_gettime(time.CLOCK_BOOTTIME) + ahead
        return self.ask("goal", goal=name, lease=lease, deadline=deadline, trajectory=path)

    def knee(self) -> float:
        """Angle of the knee, rad."""
        joints = self.ask("ask", "GetStatus", joints=True)["joints"]
        return float(next(joint["position"] for joint in joints if joint["name"] == JOINT))


def phases(replies: list[bytes]) -> list[str]:
    """Phases of a goal, in order."""
    return [json.loads(each)["phase"] for each in replies]


def up(far: Far, uplink: Uplink) -> None:
    """Wait until the robot is there."""
    until(far.there, PATIENCE, f"the uplink is up: {uplink.output}")


@contextmanager
def ended() -> Iterator[Callable[[Uplink], Uplink]]:
    """Uplinks that it is given are gone at its end, whatever happens."""
    begun: list[Uplink] = []

    def one(uplink: Uplink) -> Uplink:
        begun.append(uplink)
        return uplink

    try:
        yield one
    finally:
        for each in begun:
            each.gone()


@dataclass
class Site:
    """A daemon in sim, a router, an uplink, and somebody far away."""

    router: Router
    daemon: Daemon
    uplink: Uplink
    far: Far


@contextmanager
def site(folder: Path, name: str = "robot") -> Iterator[Site]:
    """As long as the context; the robot is called `name`."""
    with ExitStack() as stack:
        router = stack.enter_context(Router())
        made = Site(router, Daemon(folder / "run", "--mode", "sim"), None, None)  # type: ignore[arg-type]
        stack.callback(lambda: made.daemon.kill())  # a test may have begun another
        made.daemon.reach(mode="sim")
        words = ("--connect", router.endpoint, "--name", name)
        made.uplink = stack.enter_context(ended())(Uplink(made.daemon.sockets, *words))
        made.far = stack.enter_context(closing(Far(NetworkConfig(connect=(router.endpoint,)), name)))
        up(made.far, made.uplink)
        yield made


__all__ = [
    "JOINT",
    "PATIENCE",
    "Far",
    "NetworkConfig",
    "Site",
    "Uplink",
    "ended",
    "phases",
    "site",
    "up",
    "zenoh",
]
