"""Actions: three services and a topic of feedback, as the real ones."""

import uuid
from enum import IntEnum
from types import SimpleNamespace

from rclpy.task import Future

ACCEPTED, EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = range(1, 7)  # GoalStatus
AFTER = {  # state -> those that may follow it
    ACCEPTED: (EXECUTING, CANCELING),
    EXECUTING: (CANCELING, SUCCEEDED, ABORTED),
    CANCELING: (CANCELED, SUCCEEDED, ABORTED),
}


class GoalResponse(IntEnum):
    REJECT = 1
    ACCEPT = 2


class CancelResponse(IntEnum):
    REJECT = 1
    ACCEPT = 2


class ServerGoalHandle:
    def __init__(self, server, goal, identity):
        self._server = server
        self.request = goal
        self.status = ACCEPTED
        self.goal_id = SimpleNamespace(uuid=identity)

    @property
    def is_cancel_requested(self):
        return self.status == CANCELING

    @property
    def is_active(self):
        return self.status in AFTER

    def go(self, status):
        if status not in AFTER.get(self.status, ()):
            raise RuntimeError(f"goal: no way from state {self.status} to {status}")
        self.status = status

    def execute(self, execute_callback=None):
        if not self.is_cancel_requested:
            self.go(EXECUTING)
        self._server.run(self)

    def publish_feedback(self, feedback):
        self._server.tell(self, feedback)

    def succeed(self):
        self.go(SUCCEEDED)

    def abort(self):
        self.go(ABORTED)

    def canceled(self):
        self.go(CANCELED)


class ActionServer:
    def __init__(
        self,
        node,
        action_type,
        action_name,
        execute_callback,
        *,
        callback_group=None,
        goal_callback=lambda goal: GoalResponse.ACCEPT,
        handle_accepted_callback=ServerGoalHandle.execute,
        cancel_callback=lambda goal: CancelResponse.REJECT,
    ):
        self._node = node
        self._kind = action_type
        self._name = action_name = node.resolve(action_name)
        self._execute = execute_callback
        self._goal = goal_callback
        self._accepted = handle_accepted_callback
        self._cancel = cancel_callback
        self._group = callback_group or node.default_callback_group
        self._handles = {}
        self._results = {}
        self._asked = {}
        for name in ("send_goal", "cancel_goal", "get_result"):
            take = getattr(self, f"_{name}")
            node.listen(_part(action_name, name), self._soon(take), action_type.kind)

    def _soon(self, take):
        return lambda head, data: self._node.soon(self._group, lambda: take(head, data))

    def _send_goal(self, head, data):
        identity = data[:16]
        goal = self._kind.Goal.of(data[16:])
        accepted = self._goal(goal) == GoalResponse.ACCEPT
        if accepted:
            self._handles[identity] = ServerGoalHandle(self, goal, identity)
        self._node.answer(head, bytes([accepted]))
        if accepted:
            self._accepted(self._handles[identity])

    def _cancel_goal(self, head, data):
        handle = self._handles[data]
        cancelling = handle.is_active and self._cancel(handle) == CancelResponse.ACCEPT
        if cancelling and not handle.is_cancel_requested:
            handle.go(CANCELING)
        self._node.answer(head, bytes([cancelling]))

    def _get_result(self, head, data):
        self._asked.setdefault(data, []).append(head)
        self._answer(data)

    def _answer(self, identity):
        if identity in self._results:
            for head in self._asked.pop(identity, []):
                self._node.answer(head, self._results[identity])

    def run(self, handle):
        """Tasks belong to no group, so goals run beside each other."""
        self._node.soon(None, lambda: self._run(handle))

    def _run(self, handle):
        result = self._kind.Result()
        try:
            result = self._execute(handle)
        finally:
            if handle.is_active:
                handle.abort()
            identity = handle.goal_id.uuid
            self._results[identity] = bytes([handle.status]) + result.bytes()
            self._answer(identity)

    def tell(self, handle, feedback):
        """To everybody who follows a goal of this action."""
        if not isinstance(feedback, self._kind.Feedback):
            raise TypeError()
        name = _part(self._name, "feedback")
        for node, _ in self._node.wire.endpoints("reader", name):
            self._node.wire.send(
                node["address"], {"to": "topic", "name": name}, handle.goal_id.uuid + feedback.bytes()
            )

    def destroy(self):
        self._handles.clear()


class ClientGoalHandle:
    def __init__(self, client, identity, accepted):
        self._client = client
        self._identity = identity
        self.accepted = accepted

    def get_result_async(self):
        future = Future()

        def receive(data):
            result = self._client.kind.Result.of(data[1:])
            future.set_result(SimpleNamespace(status=data[0], result=result))

        self._client.ask("get_result", self._identity, receive)
        return future

    def cancel_goal_async(self):
        future = Future()

        def receive(data):
            future.set_result(SimpleNamespace(goals_canceling=[self._identity] if data[0] else []))

        self._client.ask("cancel_goal", self._identity, receive)
        return future


class ActionClient:
    def __init__(self, node, action_type, action_name):
        self._node = node
        self.kind = action_type
        self._name = action_name
        self._followed = {}
        name = _part(action_name, "feedback")
        node.wire.add(what="reader", name=name, kind=action_type.kind)
        node.follow(name, self._feedback)

    def ask(self, part, data, done):
        self._node.ask(_part(self._name, part), data, done)

    def wait_for_server(self, timeout_sec=None):
        return bool(self._node.wire.endpoints("service", _part(self._name, "send_goal")))

    def send_goal_async(self, goal, feedback_callback=None):
        future = Future()
        identity = uuid.uuid4().bytes
        self._followed[identity] = feedback_callback

        def receive(data):
            future.set_result(ClientGoalHandle(self, identity, bool(data[0])))

        self.ask("send_goal", identity + goal.bytes(), receive)
        return future

    def _feedback(self, head, data):
        callback = self._followed.get(data[:16])
        if callback is not None:
            callback(SimpleNamespace(feedback=self.kind.Feedback.of(data[16:])))


def _part(action, name):
    return f"{action}/_action/{name}"
