"""A stand-in for rclpy where there is none: the names and arguments of the real one, over UDP on 127.0.0.1.

What twind and the peers of its tests use of it, no more; who takes part finds the others by files in the
folder $ROS_STAND_IN. Standard library and `twind.ros`; any Python from 3.10 on.
`tests/bridge/test_rclpy_stand_in.py` holds its signatures against the real ones.
"""

from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

_CONTEXT = Context()


def init(*, args=None, context=None, domain_id=None, signal_handler_options=None):
    (context or _CONTEXT).init(args, domain_id=domain_id)


def ok(*, context=None):
    return (context or _CONTEXT).ok()


def create_node(node_name, *, context=None):
    return Node(node_name, context=context or _CONTEXT)


def spin_once(node, *, executor=None, timeout_sec=None):
    if node.executor is None:
        SingleThreadedExecutor(context=node.context).add_node(node)
    node.executor.spin_once(timeout_sec=timeout_sec)


def shutdown(*, context=None, uninstall_handlers=None):
    (context or _CONTEXT).shutdown()
