"""Node of the rclpy back end, under the distribution's own rclpy and interpreter.

Standard library, rclpy, and modules of twind that need only the library; Python 3.10. `rclpy_launcher` starts
it by `rclpy_main`. Services, parameters and actions work on every middleware: they are rclpy's own.
"""

from __future__ import annotations

import functools
import importlib
import os
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.context import Context
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from twind.bridge.ros.discovery import DiscoverySettings
from twind.bridge.ros.rclpy_action_server import GoalConsumer, TrajectoryActionServer
from twind.bridge.ros.rclpy_parameters import DaemonParameters, Settings
from twind.bridge.ros.rclpy_typed_messages import TypedMessages
from twind.bridge.ros.ros_endpoints import SERVICES, STATUS, TOPICS, RosService, RosTopic
from twind.bridge.ros.ros_names import NODE, ROS_ARGS, NodeName, relative
from twind.bridge.ros.ros_transport import MessageHandler, RequestHandler, answer_to
from twind.exceptions import OperationFailed

WAKE = 0.25  # s between two checks of the node's thread whether it is to end
MOST_REPORTS = 20  # errors reported in one life of the node
SPARE = 8  # threads beside one for each service and each topic that is read: parameters, goals


def message_type(kind: str) -> Any:
    """The class of `package/msg/Name`, from the distribution's packages. Raises OperationFailed."""
    package, folder, name = kind.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{folder}"), name)
    except (ImportError, AttributeError) as error:
        distro = os.environ.get("ROS_DISTRO", "DISTRO")
        remedy = f"install ros-{distro}-{package.replace('_', '-')}"
        raise OperationFailed(f"rclpy: no {kind} ({error}); {remedy}") from None


def _kinds(topics: Sequence[RosTopic], services: Sequence[RosService]) -> set[str]:
    return {topic.kind for topic in topics} | {service.kind for service in services}


def _missing(topic: RosTopic) -> str:
    """Return why the type of an optional topic is missing; "": it is there. Raises OperationFailed."""
    try:
        message_type(topic.kind)
    except OperationFailed as error:
        if not topic.optional:
            raise
        return str(error)
    return ""


def check(arguments: Sequence[str] = ()) -> None:
    """Load every message type that is required, and parse ROS's own arguments.

    Raises OperationFailed: one is missing or wrong.

    The middleware needs no check: where RMW_IMPLEMENTATION is not installed, `import rclpy` ends the process.
    """
    for kind in _kinds([topic for topic in TOPICS if not topic.optional], SERVICES):
        message_type(kind)
    context = Context()
    try:
        context.init(args=_ros_arguments(arguments))
    except RuntimeError as error:
        raise OperationFailed(f"rclpy: {ROS_ARGS} {' '.join(arguments)}: {error}") from None
    finally:
        context.try_shutdown()


def _ros_arguments(arguments: Sequence[str]) -> list[str]:
    return [ROS_ARGS, *arguments] if arguments else []


def quality(topic: RosTopic) -> Any:
    """The QoSProfile of a topic."""
    return QoSProfile(
        depth=topic.depth,
        history=HistoryPolicy.KEEP_LAST,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE,
    )


class RclpyTransport:
    """`RosTransport` over rclpy.

    `goals`: receiver of an action's goals; None: no action. `settings`: of the daemon, for the parameters.
    Both are set before `open`.
    """

    refuses = ""

    def __init__(
        self,
        found: DiscoverySettings,
        tell: Callable[[str], None],
        *,
        sockets: str | None = None,
        arguments: Sequence[str] = (),
    ) -> None:
        """Make the transport; `sockets`: of the daemon, for the reports to a goal's client.

        `arguments`: ROS's own.
        """
        self._discovery = found
        self._tell = tell
        self._sockets = sockets
        self._arguments = arguments
        self.node = str(NodeName())
        self.settings: Settings = lambda _: {}
        self.goals: GoalConsumer | None = None
        self._graph: _Graph | None = None

    def open(
        self,
        topics: Sequence[RosTopic],
        services: Sequence[RosService],
        on_message: MessageHandler,
        asked: RequestHandler,
    ) -> None:
        """Join the graph with these endpoints. Raises OperationFailed."""
        missing = {topic.name: reason for topic in topics if (reason := _missing(topic))}
        topics = [topic for topic in topics if topic.name not in missing]
        for name, reason in missing.items():
            self._tell(f"{name} is not published: {reason}")
        kinds = {kind: message_type(kind) for kind in _kinds(topics, services)}
        read = sum(not topic.out for topic in topics)
        threads = len(services) + read + SPARE
        graph = _Graph(self._discovery.domain, threads, self._tell, self._arguments)
        try:
            for topic in topics:
                graph.add(topic, kinds[topic.kind], on_message)
            for service in services:
                graph.serve(service, kinds[service.kind], asked)
            graph.parameters = DaemonParameters(graph.node, asked, frozenset(services), self.settings)
            graph.begin(self.goals, self._sockets)
        except RuntimeError as error:
            graph.close()
            raise OperationFailed(f"rclpy: {error}") from None
        self.node = graph.node.get_fully_qualified_name()
        self._graph = graph

    def publish(self, topic: RosTopic, data: bytes) -> None:
        """Send CDR bytes. How long a reader may hold this up is the middleware's. Raises OperationFailed."""
        graph = self._graph
        if graph is None or not graph.alive:
            raise OperationFailed("rclpy: the node has left the graph; it is made anew")
        publisher = graph.publishers.get(topic.name)
        if publisher is None:
            return  # the package of its type is not installed
        try:
            publisher.publish(data)
        except RuntimeError as error:
            raise OperationFailed(f"rclpy: {topic.name}: {error}") from None

    def show(self, topic: RosTopic, content: Mapping[str, Any]) -> None:
        """Take the content of a topic of JSON: for the parameters, and as a typed message."""
        graph = self._graph
        if graph is None or not graph.alive:
            return
        if topic is STATUS and graph.parameters is not None:
            graph.parameters.show(content)
        try:
            graph.typed.show(topic, content)
        except RuntimeError as error:
            raise OperationFailed(f"rclpy: {topic.name}: {error}") from None

    def close(self) -> None:
        """Leave the graph. May be called twice."""
        graph = self._graph
        self._graph = None
        if graph is not None:
            graph.close()


class _Graph:
    """One life of the node: its context, its executor in a thread of its own, its publishers."""

    def __init__(
        self, domain: int, threads: int, tell: Callable[[str], None], arguments: Sequence[str]
    ) -> None:
        self._context = Context()
        self._tell = tell
        self._reported: set[str] = set()
        try:
            # Not by rclpy.init, which would replace the caller's signal handlers.
            self._context.init(args=_ros_arguments(arguments), domain_id=domain)
            self.node = Node(NODE, context=self._context)
        except RuntimeError as error:
            self._context.try_shutdown()
            raise OperationFailed(f"rclpy: cannot join domain {domain}: {error}") from None
        self._executor = MultiThreadedExecutor(num_threads=threads, context=self._context)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._spin, name="rclpy", daemon=True)
        self.publishers: dict[str, Any] = {}
        self.typed = TypedMessages(self.node)
        self.parameters: DaemonParameters | None = None
        self._follow: TrajectoryActionServer | None = None

    @property
    def alive(self) -> bool:
        """Callbacks are served, and messages go out."""
        return self._thread.is_alive() and bool(self._context.ok())

    def add(self, topic: RosTopic, kind: Any, on_message: MessageHandler) -> None:
        """Write or read a topic, in bytes of the wire.

        What is read has a group for each topic, so that a stop waits neither for a trajectory that is looked
        at nor for the parameters, where a change of mode waits for the daemon.
        """
        name = relative(topic.name)
        if topic.out:
            self.publishers[topic.name] = self.node.create_publisher(kind, name, quality(topic))
            return
        call = functools.partial(on_message, topic)
        group = MutuallyExclusiveCallbackGroup()
        self.node.create_subscription(kind, name, call, quality(topic), callback_group=group, raw=True)

    def serve(self, service: RosService, kind: Any, asked: RequestHandler) -> None:
        """Answer a service. Each has a group: none waits for another, none takes more than one thread."""

        def answer(request: Any, response: Any) -> Any:
            try:
                response.success, response.message = answer_to(asked, service, getattr(request, "data", None))
            except Exception as error:  # noqa: BLE001  the client gets an answer in any case
                response.success = False
                response.message = f"{type(error).__name__}: {error}"
                self._complain(f"rclpy: {service.name}: {response.message}")
            return response

        group = MutuallyExclusiveCallbackGroup()
        self.node.create_service(kind, relative(service.name), answer, callback_group=group)

    def begin(self, goals: GoalConsumer | None, sockets: str | None) -> None:
        """Create the action, and serve callbacks from now on."""
        if goals is not None:
            self._follow = TrajectoryActionServer.offered(self.node, goals, sockets, self._tell)
        self._executor.add_node(self.node)
        self._thread.start()

    def _spin(self) -> None:
        while not self._closing.is_set() and self._context.ok():
            try:
                self._executor.spin_once(timeout_sec=WAKE)
            except Exception as error:  # noqa: BLE001  invalid bytes, or a defect here: go on
                self._complain(f"rclpy: {type(error).__name__}: {error}")

    def _complain(self, text: str) -> None:
        """Report each reason once, at a bounded rate: a flood of messages must not cost time here."""
        if text not in self._reported and len(self._reported) < MOST_REPORTS and self._context.ok():
            self._reported.add(text)
            self._tell(text)
        self._closing.wait(0.01)

    def close(self) -> None:
        """End callbacks, then all that they use."""
        self._closing.set()
        if self._follow is not None:
            self._follow.close()
        if self._thread.is_alive():
            self._thread.join(2.0)
        if self._follow is not None:
            self._follow.destroy()
        try:
            self._executor.shutdown(timeout_sec=0.0, wait_for_threads=False)
        except TypeError:  # Humble's never waits for them
            self._executor.shutdown(timeout_sec=0.0)
        self.node.destroy_node()
        self._context.try_shutdown()
