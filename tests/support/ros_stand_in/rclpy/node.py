"""A node: writers, readers, services, clients, parameters."""

from types import SimpleNamespace

from rcl_interfaces.msg import ParameterValue, SetParametersResult
from rcl_interfaces.srv import GetParameters, SetParameters

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, matches, profile
from rclpy.task import Future
from rclpy.wire import Wire

TYPES = {float: 3, str: 4}  # ParameterType
FIELDS = {float: "double_value", str: "string_value"}


class Publisher:
    def __init__(self, wire, kind, topic, qos):
        self._wire = wire
        self._kind = kind
        self.topic = topic
        self._qos = qos
        self._last = None

    def publish(self, msg):
        if isinstance(msg, self._kind):
            msg = msg.bytes()
        if not isinstance(msg, bytes):
            raise TypeError(f"Expected {self._kind}, got {type(msg)}")
        if self._qos["durability"] == DurabilityPolicy.TRANSIENT_LOCAL:
            self._last = msg
        for node, _ in self._readers():
            self._wire.send(node["address"], {"to": "topic", "name": self.topic}, msg)

    def late(self, address):
        """Whoever has just come has the last one too."""
        if self._last is not None:
            self._wire.send(address, {"to": "topic", "name": self.topic}, self._last)

    def get_subscription_count(self):
        return len(self._readers())

    def _readers(self):
        return [each for each in self._wire.endpoints("reader", self.topic) if matches(self._qos, each[1])]


class Client:
    def __init__(self, node, kind, name):
        self._node = node
        self._kind = kind
        self._name = name

    def wait_for_service(self, timeout_sec=None):
        return bool(self._node.wire.endpoints("service", self._name))

    def call_async(self, request):
        future = Future()
        self._node.ask(
            self._name, request.bytes(), lambda data: future.set_result(self._kind.Response.of(data))
        )
        return future


class GuardCondition:
    def __init__(self, node, callback, group):
        self._node = node
        self._callback = callback
        self._group = group

    def trigger(self):
        self._node.soon(self._group, self._callback)


class Node:
    def __init__(self, node_name, *, context=None):
        if not context.ok():
            raise RuntimeError("rcl_init() has not been called")
        self.context = context
        self.executor = None
        self._name = node_name
        self.wire = Wire(context.domain, node_name)
        self._namespace = context.namespace
        self.default_callback_group = MutuallyExclusiveCallbackGroup()
        self._parameters = {}
        self._on_set = []
        self._early = []
        self._writers = {}
        self._takers = {}
        self._waiting = {}
        self._serve("/set_parameters", SetParameters, self._set)
        self._serve("/get_parameters", GetParameters, self._get)

    # ---------------------------------------------------------------------------------------- topics

    def get_fully_qualified_name(self):
        return f"{self._namespace}/{self._name}"

    def resolve(self, name):
        """The full name."""
        return name if name.startswith("/") else f"{self._namespace}/{name}"

    def create_publisher(self, msg_type, topic, qos_profile, *, callback_group=None):
        topic = self.resolve(topic)
        qos = _quality(qos_profile)
        self._writers[topic] = Publisher(self.wire, msg_type, topic, qos)
        self.wire.add(what="writer", name=topic, kind=msg_type.kind, **qos)
        return self._writers[topic]

    def create_subscription(self, msg_type, topic, callback, qos_profile, *, callback_group=None, raw=False):
        topic = self.resolve(topic)
        group = callback_group or self.default_callback_group

        def take(head, data):
            # The real one leaves out what is no message, unless bytes are asked for: they are whatever came.
            self.soon(group, lambda: callback(data if raw else msg_type.of(data)))

        qos = _quality(qos_profile)
        self._takers["topic", topic] = take
        self.wire.add(what="reader", name=topic, kind=msg_type.kind, **qos)
        if qos["durability"] == DurabilityPolicy.TRANSIENT_LOCAL:
            for node, writer in self.wire.endpoints("writer", topic):
                if matches(writer, qos):
                    self.wire.send(node["address"], {"to": "late", "name": topic, "from": self.wire.address})

    def follow(self, name, take):
        """Take what is sent on a topic that is none of its own."""
        self._takers["topic", name] = take

    def get_publishers_info_by_topic(self, topic_name):
        return [_info(*each) for each in self.wire.endpoints("writer", topic_name)]

    def get_subscriptions_info_by_topic(self, topic_name):
        return [_info(*each) for each in self.wire.endpoints("reader", topic_name)]

    def get_node_names(self):
        return [node["node"] for node in self.wire.nodes()]

    # ---------------------------------------------------------------------------------------- services

    def create_service(self, srv_type, srv_name, callback, *, callback_group=None):
        group = callback_group or self.default_callback_group

        def take(head, data):
            request = srv_type.Request.of(data)
            self.soon(group, lambda: self.answer(head, callback(request, srv_type.Response()).bytes()))

        self.listen(self.resolve(srv_name), take, srv_type.kind)

    def create_client(self, srv_type, srv_name):
        return Client(self, srv_type, srv_name)

    def listen(self, name, take, kind=""):
        """Take requests of a service."""
        self._takers["request", name] = take
        self.wire.add(what="service", name=name, kind=kind)

    def ask(self, name, data, done):
        """Ask whoever serves `name`; `done` gets the answer's bytes, here."""
        number = len(self._waiting) + 1
        self._waiting[number] = done
        for node, _ in self.wire.endpoints("service", name)[:1]:
            head = {"to": "request", "name": name, "from": self.wire.address, "number": number}
            self.wire.send(node["address"], head, data)

    def answer(self, head, data):
        """Answer the request that had this head."""
        self.wire.send(head["from"], {"to": "reply", "number": head["number"]}, data)

    def _serve(self, name, kind, callback):
        self.create_service(kind, f"{self.get_fully_qualified_name()}{name}", callback)

    # ---------------------------------------------------------------------------------------- parameters

    def declare_parameter(self, name, value=None, descriptor=None, ignore_override=False):
        self._parameters[name] = Parameter(name, value=value)
        return self._parameters[name]

    def add_on_set_parameters_callback(self, callback):
        self._on_set.insert(0, callback)

    def set_parameters(self, parameter_list):
        return [self._set_one(each) for each in parameter_list]

    def _set_one(self, parameter):
        for callback in self._on_set:
            result = callback([parameter])
            if not result.successful:
                return result
        self._parameters[parameter.name] = parameter
        return SetParametersResult(successful=True)

    def _set(self, request, response):
        given = [
            Parameter(each.name, value=each.value.string_value or each.value.double_value)
            for each in request.parameters
        ]
        response.results = self.set_parameters(given)
        return response

    def _get(self, request, response):
        known = [self._parameters[name].value for name in request.names]
        response.values = [
            ParameterValue(type=TYPES[type(value)], **{FIELDS[type(value)]: value}) for value in known
        ]
        return response

    # ---------------------------------------------------------------------------------------- the rest

    def create_guard_condition(self, callback, callback_group=None):
        return GuardCondition(self, callback, callback_group or self.default_callback_group)

    def get_clock(self):
        return Clock()

    def soon(self, group, call):
        """From any thread; before there is an executor it waits for one."""
        self._early.append((group, call))
        while self.executor is not None and self._early:
            self.executor.soon(*self._early.pop(0))

    def take(self):
        """A datagram has come."""
        head, data = self.wire.take()
        if head["to"] == "late":
            self._writers[head["name"]].late(head["from"])
        elif head["to"] == "reply":
            self._waiting.pop(head["number"])(data)
        elif (head["to"], head["name"]) in self._takers:
            self._takers[head["to"], head["name"]](head, data)

    def destroy_node(self):
        self.wire.close()


def _quality(qos_profile):
    given = profile(qos_profile)
    return {"reliability": given.reliability, "durability": given.durability, "depth": given.depth}


def _info(node, endpoint):
    qos = SimpleNamespace(**{key: endpoint[key] for key in ("reliability", "durability", "depth")})
    return SimpleNamespace(node_name=node["node"], topic_type=endpoint["kind"], qos_profile=qos)
