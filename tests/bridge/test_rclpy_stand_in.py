"""The stand-in for rclpy takes no name and no argument that the real one does not."""

import json
import os
import subprocess
import sys
from pathlib import Path

from tests.support import rclpy_environment as ros_peer

TESTS = Path(__file__).parents[1]

# Arguments of what is named on the command line, wherever in rclpy it stands: {name: [[argument, kind], ...]}
LOOK = """
import importlib, inspect, json, sys

PLACES = "action action.server callback_groups context executors guard_condition node parameter publisher qos"

def found(name):
    for place in PLACES.split():
        try:
            thing = importlib.import_module(f"rclpy.{place}")
            for part in name.split("."):
                thing = getattr(thing, part)
            return thing
        except (ImportError, AttributeError):
            continue
    raise SystemExit(f"rclpy has no {name}")

def arguments(thing):
    if not callable(thing):
        return None
    return [[each.name, each.kind.name] for each in inspect.signature(thing).parameters.values()]

print(json.dumps({name: arguments(found(name)) for name in sys.argv[1:]}))
"""
# All that twind uses of it.
USED = """
    ActionServer ActionServer.destroy CancelResponse.ACCEPT GoalResponse.ACCEPT GoalResponse.REJECT
    ServerGoalHandle.execute ServerGoalHandle.publish_feedback ServerGoalHandle.succeed ServerGoalHandle.abort
    ServerGoalHandle.canceled ServerGoalHandle.is_cancel_requested
    MutuallyExclusiveCallbackGroup Context Context.init Context.ok Context.try_shutdown
    MultiThreadedExecutor MultiThreadedExecutor.add_node MultiThreadedExecutor.spin_once
    MultiThreadedExecutor.shutdown GuardCondition.trigger
    Node Node.create_publisher Node.create_subscription Node.create_service Node.create_guard_condition
    Node.declare_parameter Node.add_on_set_parameters_callback Node.set_parameters Node.get_clock
    Node.destroy_node Node.get_fully_qualified_name Parameter Publisher.publish
    QoSProfile ReliabilityPolicy.RELIABLE DurabilityPolicy.VOLATILE DurabilityPolicy.TRANSIENT_LOCAL
    HistoryPolicy.KEEP_LAST
"""


def looked(python: str, path: str) -> dict[str, list[list[str]] | None]:
    environment = os.environ | {"PYTHONPATH": path}
    words = [python, "-c", LOOK, *USED.split()]
    done = subprocess.run(words, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found: dict[str, list[list[str]] | None] = json.loads(done.stdout)
    return found


def test_the_stand_in_takes_nothing_that_the_real_one_does_not() -> None:
    real = looked(ros_peer.python(), "")
    stand_in = looked(sys.executable, f"{TESTS / 'support/ros_stand_in'}:{TESTS.parent}")
    compared = 0
    for name, arguments in stand_in.items():
        theirs = real[name]
        if arguments is None or theirs is None:  # a value; that it is there was what had to be known
            assert arguments is theirs, name
            continue
        for argument in arguments:
            assert argument in theirs or ["kwargs", "VAR_KEYWORD"] in theirs, (
                f"{name}: {argument} not in {theirs}"
            )
            compared += 1
    assert compared > 50
