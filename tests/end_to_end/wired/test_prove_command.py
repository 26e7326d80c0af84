"""`twindctl calibrate prove` through a real daemon on virtual servos."""

import json
import time
from collections.abc import Iterator
from typing import Any

import pytest

from tests.support.processes import PATIENCE, Daemon, Virtual, arm, daemon, robot, until
from twind.command_line.verb import Rejected
from twind.config.calibration_file import load_calibration
from twind.config.robot_file import load_robot
from twind.ctl.ctl_main import main
from twind_calibration.proving.proof_pose_motion import posed
from twind_calibration.wiggling.joint_move import goal_of

Captured = pytest.CaptureFixture[str]
H24 = load_robot("h24")
# s that one takes, and it may have to be armed again before
TRIES = 5
TRY = 20.0


@pytest.fixture(scope="module")
def running() -> Iterator[tuple[Virtual, Daemon]]:
    with robot("h24") as (virtual, folder), daemon(virtual, folder) as one:
        one.reach(state="connected")
        yield virtual, one


def on_its_back(virtual: Virtual, one: Daemon) -> None:
    """Armed while it hangs, its waist propped, then laid down."""
    virtual.order(fault="lay", base="upright")
    with one.client() as client:
        client.call("Disarm")
        client.call("Reset")
        arm(client)
    virtual.order(fault="lock", id=12)
    virtual.order(fault="lay", base="back")


def proved(
    virtual: Virtual, one: Daemon, capsys: Captured, name: str
) -> tuple[int, dict[str, Any], list[dict[str, Any]]]:
    """Exit code, what is said of a joint and what is left to say; again where the machine had no time."""
    deadline = time.monotonic() + TRIES * (TRY + PATIENCE)
    words = ["--json", "calibrate", "prove", "--yes", "--base", "back", name]
    while True:
        capsys.readouterr()
        code = main(["--socket", str(one.sockets), *words])
        told, *rest = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
        if told.get("proof") is not None:
            return code, told, rest
        assert time.monotonic() < deadline, told
        on_its_back(virtual, one)


def test_a_proved_joint_is_recorded(running: tuple[Virtual, Daemon], capsys: Captured) -> None:
    """A contradicted one: tests/calibration/test_proof_on_servos.py and test_proof_report.py."""
    virtual, one = running
    on_its_back(virtual, one)
    code, left, rest = proved(virtual, one, capsys, "l_hip_pitch")
    assert (code, left["proof"], left["against"]) == (0, "proved", None)
    assert rest == [{"written": str(virtual.calibration), "new": ["l_hip_pitch"], "gone": []}]
    by_name = load_calibration(virtual.calibration, H24).by_name
    proof = by_name["l_hip_pitch"].proof
    assert isinstance(proof, dict)
    assert (proof["sign"], proof["base_pose"]) == ("gravity", "back")
    assert proof["slope_ratio"] == pytest.approx(1.0, abs=0.1)
    assert [name for name, entry in by_name.items() if entry.proof is not None] == ["l_hip_pitch"]
    assert main(["--socket", str(one.sockets), "reload"]) == 0
    assert "calibration.proof" in capsys.readouterr().out


def test_a_pose_is_gone_to_and_left_again_and_one_that_the_gate_refuses_moves_nothing(
    running: tuple[Virtual, Daemon],
) -> None:
    virtual, one = running
    with one.client() as client:
        client.call("Disarm")
        until(lambda: not any(servo["torque"] for servo in virtual.servos()), 20.0, "torque off")
        one.reach(armed=False)
        client.call("SetMode", mode="sim")  # the same gate, executor and lease
        with posed(client, {"l_knee": 0.3, "r_knee": 0.2}, take=False):
            assert goal_of(client, "l_knee") == pytest.approx(0.3, abs=1e-6)
            assert goal_of(client, "r_knee") == pytest.approx(0.2, abs=1e-6)
        assert goal_of(client, "l_knee") == pytest.approx(0.0, abs=0.05)
        before = goal_of(client, "l_knee")
        with pytest.raises(Rejected, match="POS_LIMIT"), posed(client, {"l_knee": 9.0}, take=False):
            raise AssertionError("it was let go there")
        assert goal_of(client, "l_knee") == before
