"""The buses of a recording on pseudo-terminals, served by a thread of this process until it is closed."""

import gc
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from threading import Thread

from twind.observe.replaying.exec_with_priority import PORTS, first
from twind.observe.replaying.replay_bus import ReplayBus
from twind.virtual.pty_port import VirtualPtyPort
from twind.virtual.virtual_server import ServoClock, VirtualBusServer
from twind_drivers.clock import Clock

SWITCH = 0.0005  # s between two threads of Python: else an answer waits 5 ms for a computing thread


class ReplayClock(ServoClock):
    """Clock that leaves no time out, shared with the clients of the replay."""

    def __init__(self, clock: Clock) -> None:
        super().__init__(clock)
        self._real = clock

    @property
    def skipped_time(self) -> float:
        """None is."""
        return 0.0

    def now(self) -> float:
        """s."""
        return self._real.now()


class ReplayPorts:
    """Context manager: the links are there inside, and gone outside."""

    def __init__(
        self, buses: Sequence[ReplayBus], links: Mapping[str, Path], clock: Clock, *, realtime: bool = False
    ) -> None:
        """`links`, by bus name, keep their names when a port comes back as another one.

        `realtime`: this thread and ours before the ordinary programs of this machine, after a robot's daemon.

        Raises OSError: no pseudo-terminal to be had.
        """
        self._ports = {bus.name: VirtualPtyPort(bus.name, links[bus.name]) for bus in buses}
        for bus in buses:
            bus.on_plug = self._plugging(self._ports[bus.name])
        self._server = VirtualBusServer(
            {bus.name: bus for bus in buses}, self._ports, ReplayClock(clock), lambda *_: None
        )
        self._realtime = realtime
        self._failure: Exception | None = None
        self._thread = Thread(target=self._run, name="ports", daemon=True)

    def __enter__(self) -> "ReplayPorts":
        self._before = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH)
        gc.freeze()  # a whole recording: to look through it takes longer than an answer may
        self._thread.start()
        if self._realtime:  # else threads that wait for the commanding one would wait for other programs too
            first(PORTS)
        return self

    def __exit__(self, *_: object) -> None:
        self._server.ended = True
        self._thread.join()
        for port in self._ports.values():
            port.close()
        sys.setswitchinterval(self._before)
        gc.unfreeze()

    def _run(self) -> None:
        if self._realtime:
            first(PORTS)
        try:
            self._server.run()
        except Exception as error:  # noqa: BLE001 - raised by `check`, in the thread that waits for the replay
            self._failure = error

    @staticmethod
    def _plugging(port: VirtualPtyPort) -> Callable[[bool], None]:
        return lambda there: port.plug() if there else port.unplug()

    def check(self) -> None:
        """Raises what ended the thread, if anything did."""
        if self._failure is not None:
            raise self._failure
