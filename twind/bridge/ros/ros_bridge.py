"""One run of a ROS bridge, over any number of daemons and lives of the graph. Library, 3.10.

Two threads listen to the daemon, one to its readings, one to all else, and publish at once. `RosCommands` has
those of commands. This one joins the graph, again after a loss, and reports its state once a second. No
thread waits for a reader: messages that the graph does not accept are dropped, and those that the daemon had
to drop are counted.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from twind.bridge.commands.control_socket_access import denied
from twind.bridge.commands.stop_queues import Outcome
from twind.bridge.ros.daemon_subscriber import RosSubscriber
from twind.bridge.ros.description_request import DescriptionRequest
from twind.bridge.ros.peer_bridges import PeerBridges
from twind.bridge.ros.robot_model_messages import RobotModelMessages, describe
from twind.bridge.ros.ros_commands import RosCommands, error_text, result_line
from twind.bridge.ros.ros_diagnostics import (
    Diagnostics,
    command_latency,
    encode_string,
    latencies,
    log_message,
)
from twind.bridge.ros.ros_endpoints import (
    DESCRIBED,
    DESCRIPTION,
    DIAGNOSTICS,
    FIXED_FRAMES,
    GET_STATUS,
    LATENCIES,
    LATENCY,
    NEIGHBOURS,
    RESULTS,
    ROSOUT,
    SERVICES,
    STATUS,
    TOPICS,
    RosService,
    RosTopic,
)
from twind.bridge.ros.ros_state_messages import Message, RosStateMessages
from twind.bridge.ros.ros_transport import Reply, RosTransport
from twind.client import Client, ClientError, NoDaemon
from twind.client.clock_pair import clocks
from twind.client.monitor_stream import RepeatedFaultFilter
from twind.exceptions import OperationFailed

OTHERS = ("status", "latency", "events", "trajectories")
OFTEN = 10.0  # Hz, of status and latencies, where they change
AGAIN = 1.0  # s between two attempts to join the graph, and two diagnostics
STATUS_PERIOD = 0.5  # s between two statuses that differ in numbers alone
URGENT = ("mode", "state", "motion", "armed", "hw_connected", "faults")
REACH = 0.5  # s to be let in at observe.sock: a full queue must not hold up an e-stop
NO_COMMANDS = "--no-commands; from ROS only the e-stop is executed"
GRACE = 1.0  # s at the end: to give the lease back, and to leave the graph


class RosBridge:
    """Running bridge.

    `run` returns the exit code. `commands` takes goals of a back end's actions too.
    """

    def __init__(
        self,
        transport: RosTransport,
        sockets: str | None = None,
        *,
        rate: float | None = None,
        commands: bool = True,
        describer: str | None = None,
        tell: Callable[[str], None],
        stop: threading.Event,
    ) -> None:
        """Make the bridge; `sockets`: folder of the daemon's.

        `rate`: readings a second; None: the loop's rate. `describer`: Python that describes the robot; None:
        no description and no transforms.
        """
        self._transport = transport
        self._tell = tell
        self._stop = stop
        self._sockets = sockets
        self._reads_only = transport.refuses or ("" if commands else NO_COMMANDS)  # why no command is taken
        self._messages = RosStateMessages()
        self._describer = describer
        self._diagnostics = Diagnostics()
        self._graph = RepeatedFaultFilter()
        self._deaf = RepeatedFaultFilter()
        self._odd = RepeatedFaultFilter()
        self._neighbours = PeerBridges()
        self._alone = RepeatedFaultFilter()
        self.commands = RosCommands(
            self._operator,
            self._observer,
            status=self._status_text,
            closed=self._closed,
            on_result=self._result,
            tell=tell,
        )
        self._readings = RosSubscriber(self._observer, ("state",), self._reading, tell, stop, rate=rate)
        self._news = RosSubscriber(self._observer, OTHERS, self._take, lambda _: None, stop, rate=OFTEN)
        self._description = DescriptionRequest(
            self._observer,
            partial(describe, describer or ""),
            self._take_description,
            lambda: self._news.lives,
            tell,
            stop,
        )
        self._joined = False
        self._wrong = ""  # with the graph
        self._denied = ""  # why this user may not command
        self.asked_of = -1  # lives of the daemon when that was asked
        self._over = ""  # why nothing more is published
        self._status: Mapping[str, Any] | None = None
        self._joints: Sequence[Mapping[str, Any]] = ()
        self._published_at = float("-inf")

    def run(self) -> int:
        """Run until a stop signal; return 0."""
        try:
            self.commands.start()
            self._readings.start()
            self._news.start()
            while not self._stop.is_set():
                self._tended()
                self._stop.wait(AGAIN)
        finally:
            self._stop.set()
            self._end()
        return 0

    # ------------------------------------------------------------------------------------------ the graph

    def _tended(self) -> None:
        """Run `_tend`; a message of another daemon version that cannot be decoded does not end it."""
        wrong = ""
        try:
            self._join_or_report()
        except Exception as error:  # noqa: BLE001  ending here would cancel every motion
            wrong = f"{type(error).__name__}: {error}; tried again"
        if self._odd.is_transition(wrong, time.monotonic()) and wrong:
            self._tell(wrong)

    def _join_or_report(self) -> None:
        """Join the graph if it is not joined; publish the diagnostics."""
        if self._news.lives != self.asked_of:
            self.asked_of = self._news.lives
            self._ask_rights()
            if self._describer and self._news.there:
                self._description.start(self._news.lives)
        if not self._joined:
            self._join()
        if self._readings.error_text:
            self._joints = ()
        if self._news.error_text or not self._news.there:
            self._status = None
            self._publish_status()
        if not self._reads_only:
            both = self._neighbours.conflict_text()
            if self._alone.is_transition(both, time.monotonic()):
                self._tell(both or "the other bridge is gone: commands are taken again")
        deaf = self._news.error if self._readings.there else ""  # a daemon that is away is reported once
        if self._deaf.is_transition(deaf, time.monotonic()) and deaf:
            self._tell(f"{deaf}; status and results are missing")
        now = clocks().wall_ns
        self._publish(DIAGNOSTICS, self._diagnostics.message(now, self._bridge(), self._status, self._joints))

    def _join(self) -> None:
        self._transport.close()
        try:
            topics = [each for each in TOPICS if self._describer or each not in DESCRIBED]
            self._transport.open((*topics, NEIGHBOURS), SERVICES, self._on_message, self._on_request)
        except OperationFailed as error:
            self._wrong = str(error)
        else:
            self._joined = True
            self._wrong = ""
            self._publish_status()
            self._publish_description()
        if self._graph.is_transition(self._wrong, time.monotonic()):
            self._tell(f"{self._wrong}; tried again" if self._wrong else "the graph is joined again")

    def _publish(self, topic: RosTopic, data: bytes) -> None:
        if not self._joined:
            return
        try:
            self._transport.publish(topic, data)
        except OperationFailed as error:
            if self._stop.is_set():
                return  # this bridge is leaving it
            self._joined = False
            self._wrong = str(error)
            if self._graph.is_transition(self._wrong, time.monotonic()):
                self._tell(f"{self._wrong}; tried again")

    def _on_message(self, topic: RosTopic, data: bytes) -> None:
        """A message of the graph; in a thread of the back end."""
        if topic == NEIGHBOURS:
            self._neighbours.on_bridge_status(data)
        else:
            self.commands.on_message(topic, data)

    def _on_request(self, service: RosService, data: bool | None, reply: Reply) -> None:
        """A request of the graph; in a thread of the back end."""

        def on_reply(done: bool, message: str) -> None:
            if service is not GET_STATUS:
                phase = "done" if done else "refused"
                self._tell(result_line({"topic": service.name, "phase": phase, "message": message}))
            reply(done, message)

        self.commands.on_request(service, data, on_reply)

    def _result(self, result: Mapping[str, Any]) -> None:
        self._tell(result_line(result))
        robot = (self._status or {}).get("robot")
        content = {**result, "robot": robot, "bridge": self._neighbours.id}
        self._publish(RESULTS, encode_string(content))
        self._show(RESULTS, content)
        if result["phase"] == "refused":
            self._report("warning", result_line(result))

    def _closed(self, stop: bool = False) -> str:
        """Return why no command is taken, or, with `stop`, no stop; "": they are. An e-stop always is."""
        if self._reads_only:
            return f"this bridge only reads: {self._reads_only}"
        if self._denied:
            return f"this bridge only reads: {self._denied}; only the e-stop is executed"
        return "" if stop else self._neighbours.conflict_text()

    # ------------------------------------------------------------------------------------------ the daemon

    def _observer(self) -> Client:
        """A connection that only reads, and stops: it leaves the operators their places."""
        client = Client(self._sockets, name="observe", timeout=REACH)
        try:
            client.connect()
        except NoDaemon:
            return self._operator()
        return client

    def _operator(self) -> Client:
        return Client(self._sockets)

    def _reading(self, answer: Mapping[str, Any]) -> None:
        """Publish a reading, in its thread."""
        self._joints = answer["joints"]
        self._send(self._messages.state(answer, clocks()))

    def _take(self, answer: Mapping[str, Any]) -> None:
        """Publish any other answer, in its thread."""
        topic = answer["topic"]
        if topic == "status":
            self._messages.status(answer["status"])
            self._keep(answer["status"], answer["time"])
        elif topic == "latency":
            self._publish(LATENCY, command_latency(answer["latency"]))
            self._publish(LATENCIES, latencies(answer["latency"]))
        elif topic == "trajectories":
            self._send(self._messages.accepted(answer, clocks()))
        elif topic == "events":
            self._report(answer["event"]["level"], f"{answer['event']['code']}: {answer['event']['message']}")
        self.commands.motions.on_monitor_reply(answer)

    def _report(self, level: str, text: str) -> None:
        """Publish a line on /rosout."""
        self._publish(ROSOUT, log_message(clocks().wall_ns, self._transport.node, level, text))

    def _send(self, messages: Sequence[Message]) -> None:
        for topic, data in messages:
            self._publish(topic, data)

    def _keep(self, status: Mapping[str, Any], time: float) -> None:
        """Publish a status with news at once, others at a low rate."""
        before = self._status
        self._status = status
        news = before is None or any(before[key] != status[key] for key in URGENT)
        if news or time - self._published_at >= STATUS_PERIOD:
            self._published_at = time
            self._publish_status()

    def _take_description(self, found: RobotModelMessages | None) -> None:
        """Publish URDF and frames of the daemon's robot; None: they are not known."""
        self._messages.description = found
        self._publish_description()

    def _publish_description(self) -> None:
        description = self._messages.description
        if description is not None:
            self._publish(DESCRIPTION, description.urdf)
            self._publish(FIXED_FRAMES, description.fixed(clocks().wall_ns))

    def _ask_rights(self) -> None:
        """Request the rights once for each daemon: without them no commands are offered."""
        found = "" if self._reads_only else denied(self._operator)
        if found is None or bool(found) == bool(self._denied):
            return
        self._denied = found
        self._tell(f"no command is taken from ROS: {found}" if found else "commands are taken from ROS")

    # ------------------------------------------------------------------------------------------ own status

    def _bridge(self) -> dict[str, Any]:
        """Return the bridge's own state, which a reader of a latched status needs to judge the rest."""
        daemon = self._over or self._news.error_text
        return {
            "id": self._neighbours.id,
            "node": self._transport.node,
            "daemon": self._news.there and not daemon,
            "error": daemon or self._readings.error_text or self._wrong or None,
            "commands": not (self._reads_only or self._denied or self._over),
            "refuses": self._closed() or None,
            "dropped": self._readings.dropped + self._news.dropped,
            "undelivered": getattr(self._transport, "dropped", 0),  # counted by DDS alone
            "driving": 0 if self._over else len(self.commands.motions.moving),
        }

    def _make_status(self) -> dict[str, Any]:
        status = None if self._over or self._news.error_text else self._status
        return {**(status or {}), "bridge": self._bridge()}

    def _publish_status(self) -> None:
        status = self._make_status()
        self._publish(STATUS, encode_string(status))
        self._show(STATUS, {**status, "joints": self._joints})

    def _show(self, topic: RosTopic, content: Mapping[str, Any]) -> None:
        if self._joined:
            self._transport.show(topic, content)

    def _status_text(self, now: Outcome) -> str:
        """Return the status text from the daemon's present status, or the reason why there is none."""
        bridge = self._bridge()
        if isinstance(now, ClientError):
            bridge |= {"daemon": False, "error": error_text(now)}
        status = {} if isinstance(now, ClientError) else now["status"]
        return json.dumps({**status, "bridge": bridge}, ensure_ascii=False)

    def _end(self) -> None:
        """Release the lease first, so that motions end. A thread that hangs is left behind after GRACE."""
        self.commands.stop(GRACE)
        leaving = threading.Thread(target=self._leave, name="leaving", daemon=True)
        leaving.start()
        leaving.join(GRACE)

    def _leave(self) -> None:
        """Send the last message, which reports that the bridge is gone."""
        self._over = "the bridge has ended"
        self._publish_status()
        self._joined = False
        self._transport.close()
