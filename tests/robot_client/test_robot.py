"""`Robot`: what it asks the daemon, and the errors that it raises. The daemon's answers are given."""

from collections.abc import Iterator
from typing import Any

import pytest

from twind.client import CallError
from twind.exceptions import InvalidInput
from twind.robot_client import robot as module
from twind.robot_client.robot import Robot

NAMES = ("hip", "knee")


class AnsweringClient:
    """A client of a daemon that is in `state`, whose joints have `torque`."""

    path = "control.sock"
    connected = True
    timeout = 1.0

    def __init__(self) -> None:
        self.sent: list[tuple[str, Any]] = []
        self.state = "connected"
        self.torque = {"hip": False, "knee": False}
        self.fails = ""  # method that is answered with Busy

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self.sent.append((method, parameters.get("joints")))
        if method == self.fails:
            raise CallError("io.twind.Control.Busy", {"what": "the e-stop lowers the robot"})
        joints = [{"name": name, "torque": on} for name, on in self.torque.items()]
        status = {"armed": any(self.torque.values()), "state": self.state}
        description = {"name": "leg", "poses": {}, "joints": [{"name": name} for name in NAMES]}
        return {"robot": description, "status": status, "joints": joints}

    def is_hung_up(self) -> bool:
        return False

    def notify(self, method: str, **parameters: Any) -> None:
        """A renewal of the lease."""

    def close(self) -> None:
        self.connected = False

    def arm(self, *limp: str) -> None:
        self.state = "armed"
        self.torque = {name: name not in limp for name in NAMES}

    def asked(self, method: str) -> list[Any]:
        return [joints for sent, joints in self.sent if sent == method]


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch) -> AnsweringClient:
    made = AnsweringClient()
    monkeypatch.setattr(module, "Client", lambda socket, name: made)
    return made


@pytest.fixture
def robot(client: AnsweringClient) -> Iterator[Robot]:
    with Robot() as made:
        yield made


@pytest.mark.parametrize("state", ["arming", "settling", "fault", "estop"])
def test_only_a_robot_that_takes_motions_is_armed(client: AnsweringClient, robot: Robot, state: str) -> None:
    client.arm()
    assert robot.armed
    client.state = state  # its torque is on
    assert not robot.armed


def test_arming_an_armed_robot_takes_the_lease_and_changes_nothing(
    client: AnsweringClient, robot: Robot
) -> None:
    client.arm("knee")
    robot.arm(limp=["knee"])
    assert client.asked("AcquireLease") and not client.asked("Arm")


@pytest.mark.parametrize("state", ["connected", "settling", "fault"])
def test_arming_is_left_to_the_daemon_in_every_other_state(
    client: AnsweringClient, robot: Robot, state: str
) -> None:
    client.arm()
    client.state = state
    robot.arm()
    assert client.asked("Arm") == [None]


def test_other_limp_joints_than_now_are_left_to_the_daemon(client: AnsweringClient, robot: Robot) -> None:
    client.arm()
    robot.arm(limp=["knee"])
    assert client.asked("Arm") == [["hip"]]


def test_a_disarm_that_fails_at_the_end_does_not_hide_the_error_before_it(client: AnsweringClient) -> None:
    client.fails = "Disarm"

    def fail() -> None:
        with Robot(disarm=True) as robot:
            robot.arm()
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError) as raised:
        fail()
    assert raised.value.__notes__ == ["leg was not disarmed: busy: the e-stop lowers the robot"]
    client.connected = True
    with pytest.raises(CallError, match="busy"), Robot(disarm=True) as robot:
        robot.arm()


def test_a_goal_that_is_no_number_is_refused_with_joint_and_value(robot: Robot) -> None:
    with pytest.raises(InvalidInput, match="move: knee: 'a' is no number"):
        robot.move({"hip": 0.1, "knee": "a"})  # type: ignore[dict-item]
