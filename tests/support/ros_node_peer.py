"""A node of ROS that meets twind's: rclpy alone, the real one or the stand-in. `python ros_node_peer.py`.

One order a line of standard input, one answer a line of standard output, JSON. It ends with its input.
"""

import json
import queue
import sys
import threading
import time

import rclpy
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

TYPES = (JointState, Float64, Float64MultiArray, String, JointTrajectory, Clock)
KINDS = {each.__name__: each for each in TYPES}
SERVICES = {"Trigger": Trigger, "SetBool": SetBool}
PATIENCE = 20.0  # s
TEXT = 4  # rcl_interfaces/msg/ParameterType PARAMETER_STRING


class Peer:
    def __init__(self):
        rclpy.init()
        self.node = rclpy.create_node("peer")
        self.heard = {}
        self.writers = {}
        self.clients = {}
        self.actions = None

    def until(self, done, seconds=PATIENCE):
        end = time.monotonic() + seconds
        while not done():
            if time.monotonic() > end:
                return False
            rclpy.spin_once(self.node, timeout_sec=0.02)
        return True

    def answer(self, future):
        assert self.until(future.done), "no answer"
        return future.result()

    # ---------------------------------------------------------------------------------------- orders

    def names(self):
        return self.node.get_node_names()

    def writers_of(self, topic):
        return [
            {
                "node": each.node_name,
                "kind": each.topic_type,
                "reliable": int(each.qos_profile.reliability) == 1,
                "latched": int(each.qos_profile.durability) == 1,
            }
            for each in self.node.get_publishers_info_by_topic(topic)
        ]

    def readers(self, topic):
        return [each.node_name for each in self.node.get_subscriptions_info_by_topic(topic)]

    def serves(self, service):
        client = self.node.create_client(Trigger, service)
        return self.until(lambda: client.wait_for_service(timeout_sec=0.02), 1.0)

    def hear(self, topic, kind, latched=False):
        """Subscribe; False: the package of the type is not installed."""
        if kind == "TFMessage":
            try:
                from tf2_msgs.msg import TFMessage
            except ImportError:
                return False
            KINDS[kind] = TFMessage
        self.heard[topic] = []
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        qos = QoSProfile(depth=10, durability=durability)
        self.node.create_subscription(KINDS[kind], topic, self.heard[topic].append, qos)
        return True

    def next(self, topic, seconds=PATIENCE):
        """The next message that comes, in plain; null: none within so many seconds."""
        waiting = self.heard[topic]
        return plain(waiting.pop(0)) if self.until(lambda: waiting, seconds) else None

    def newest(self, topic):
        """The newest that has come, at least one; those before are forgotten."""
        waiting = self.heard[topic]
        assert self.until(lambda: waiting), f"nothing on {topic}"
        newest = waiting[-1]
        waiting.clear()
        return plain(newest)

    def say(self, topic, **fields):
        writer = self.writer(topic, JointTrajectory)
        writer.publish(trajectory(**fields))

    def say_bytes(self, topic, data, kind="JointTrajectory"):
        self.writer(topic, KINDS[kind]).publish(bytes.fromhex(data))

    def writer(self, topic, kind):
        if topic not in self.writers:
            self.writers[topic] = self.node.create_publisher(kind, topic, 10)
            assert self.until(lambda: self.writers[topic].get_subscription_count()), f"nobody reads {topic}"
        return self.writers[topic]

    def ask(self, service, kind, **fields):
        answer = self.answer(self.begin(service, SERVICES[kind], **fields))
        return [answer.success, answer.message]

    def race(self, slow, quick):
        """Ask the one, then the other: seconds until each was answered."""
        begun = time.monotonic()
        over = {}
        waiting = {name: self.begin(name, Trigger) for name in (slow, quick)}
        while len(over) < 2:
            rclpy.spin_once(self.node, timeout_sec=0.02)
            for name, future in waiting.items():
                if future.done():
                    over.setdefault(name, time.monotonic() - begun)
            assert time.monotonic() < begun + PATIENCE, over
        return [over[slow], over[quick]]

    def begin(self, service, kind, **fields):
        if service not in self.clients:
            self.clients[service] = self.node.create_client(kind, service)
            assert self.until(lambda: self.clients[service].wait_for_service(timeout_sec=0.02)), service
        return self.clients[service].call_async(kind.Request(**fields))

    def set_mode(self, mode):
        value = ParameterValue(type=TEXT, string_value=mode)
        given = [Parameter(name="mode", value=value)]
        result = self.answer(self.begin("/twind/set_parameters", SetParameters, parameters=given)).results[0]
        return [result.successful, result.reason]

    def mode(self):
        answer = self.answer(self.begin("/twind/get_parameters", GetParameters, names=["mode"]))
        return answer.values[0].string_value

    def goal(self, **fields):
        from control_msgs.action import FollowJointTrajectory
        from rclpy.action import ActionClient

        if self.actions is None:
            self.actions = ActionClient(self.node, FollowJointTrajectory, "/cmd/follow_joint_trajectory")
        assert self.until(lambda: self.actions.wait_for_server(timeout_sec=0.02)), "no action"
        return FollowJointTrajectory.Goal(trajectory=trajectory(**fields))

    def follow_many(self, count, **fields):
        """So many goals at once, then a stop: which were accepted, was it answered, how did they end."""
        goal = self.goal(**fields)
        handles = [self.answer(self.actions.send_goal_async(goal)) for _ in range(count)]
        stopped = self.ask("/bridge/stop", "Trigger")[0]
        results = [each.get_result_async() for each in handles if each.accepted]
        ends = [self.answer(each) for each in results]
        return [[each.accepted for each in handles], stopped, [end.result.error_code for end in ends]]

    def follow(self, cancel_after=None, path=None, **fields):
        """A goal of the action to its end: [status, code, words, feedback messages, last difference]."""
        goal = self.goal(**fields)
        if path is not None:
            from control_msgs.msg import JointTolerance

            goal.path_tolerance = [JointTolerance(name=fields["joints"][0], position=path)]
        told = []
        sent = self.actions.send_goal_async(goal, feedback_callback=lambda each: told.append(each.feedback))
        handle = self.answer(sent)
        if not handle.accepted:
            return ["rejected"]
        result = handle.get_result_async()
        if cancel_after is not None:
            self.until(lambda: False, cancel_after)
            assert self.answer(handle.cancel_goal_async()).goals_canceling
        end = self.answer(result)
        last = list(told[-1].error.positions) if told else None
        return [end.status, end.result.error_code, end.result.error_string, len(told), last]


def trajectory(joints, positions, seconds, stamp=0):
    message = JointTrajectory(joint_names=joints)
    point = JointTrajectoryPoint(positions=positions)
    point.time_from_start.sec = int(seconds)
    point.time_from_start.nanosec = int(seconds % 1 * 1e9)
    message.points = [point]
    message.header.stamp.sec = int(stamp)
    return message


def plain(message):
    if isinstance(message, JointState):
        stamp = message.header.stamp
        return {
            "time": stamp.sec + stamp.nanosec / 1e9,
            "name": list(message.name),
            "position": list(message.position),
        }
    if isinstance(message, JointTrajectory):
        return {"joints": list(message.joint_names), "frame": message.header.frame_id}
    if isinstance(message, Clock):
        return message.clock.sec + message.clock.nanosec / 1e9
    if "TFMessage" in KINDS and isinstance(message, KINDS["TFMessage"]):
        return [frame(each) for each in message.transforms]
    return list(message.data) if isinstance(message, Float64MultiArray) else message.data


def frame(each):
    stamp = each.header.stamp
    turn = each.transform.rotation
    move = each.transform.translation
    return {
        "time": stamp.sec + stamp.nanosec / 1e9,
        "parent": each.header.frame_id,
        "child": each.child_frame_id,
        "position": [move.x, move.y, move.z],
        "rotation": [turn.w, turn.x, turn.y, turn.z],
    }


def main():
    peer = Peer()
    orders = queue.Queue()

    def read():
        for line in sys.stdin:
            orders.put(line)
        orders.put(None)

    threading.Thread(target=read, daemon=True).start()
    while True:
        rclpy.spin_once(peer.node, timeout_sec=0.01)
        if orders.empty():
            continue
        line = orders.get()
        if line is None:
            break
        order = json.loads(line)
        print(json.dumps(getattr(peer, order.pop("do"))(**order)), flush=True)
    rclpy.shutdown()


if __name__ == "__main__":
    main()
