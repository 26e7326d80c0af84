"""Names of the node and its endpoints under `--ros-args`."""

import pytest

from twind.bridge.ros.ros_names import GLOBAL, NodeName, node_name, relative
from twind.command_line.verb import UsageError


def test_a_namespace_changes_all_names_but_the_global_ones() -> None:
    left = node_name(["-r", "__ns:=/left", "--remap", "__node:=arm"])
    assert str(left) == "/left/arm" and str(node_name([])) == "/twind"
    assert left.full("/joint_states") == "/left/joint_states"
    assert relative("/cmd/joint_trajectory") == "cmd/joint_trajectory"
    for name in GLOBAL:
        assert left.full(name) == relative(name) == name
    assert node_name(["-r", "__ns:=/"]) == NodeName()


@pytest.mark.parametrize(
    "words",
    [["-r"], ["-r", "__ns:=left"], ["-r", "__ns:=/1"], ["-p", "mode:=live"], ["-r", "a:=b"], ["--foo"]],
)
def test_what_only_rclpy_supports_is_refused(words: list[str]) -> None:
    with pytest.raises(UsageError, match="--backend rclpy takes all arguments of ROS"):
        node_name(words)
