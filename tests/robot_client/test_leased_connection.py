"""The order of lease, motion and stop on one connection."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, cast

import pytest

from twind.client import Client, MotionFailed, NoAnswer, Refused
from twind.robot_client.leased_connection import LeasedConnection

PATH = {"joint_names": ["yaw"], "points": []}


class RecordingClient:
    """A client whose answers are given, and which records what is sent."""

    timeout = 1.0
    path = "control.sock"
    connected = True

    def __init__(self) -> None:
        self.sent: list[str] = []
        self.patience: list[float] = []  # s
        self.phases = ["accepted", "running", "succeeded"]
        self.while_sending: Callable[[], None] = lambda: None
        self.refusal: Refused | None = None

    @contextmanager
    def within(self, seconds: float) -> Iterator[None]:
        self.patience.append(seconds)
        yield

    def is_hung_up(self) -> bool:
        return False

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self.sent.append(method)
        if method not in ("AcquireLease", "ReleaseLease") and self.refusal is not None:
            raise self.refusal
        return {}

    def stream(self, method: str, **parameters: Any) -> Iterator[dict[str, Any]]:
        self.while_sending()
        self.sent.append(method)
        return ({"phase": phase} for phase in self.phases)

    def notify(self, method: str, **parameters: Any) -> None:
        if method != "RenewLease":
            self.sent.append(method)

    def close(self) -> None:
        self.connected = False


@pytest.fixture
def client() -> RecordingClient:
    return RecordingClient()


@pytest.fixture
def connection(client: RecordingClient) -> Iterator[LeasedConnection]:
    made = LeasedConnection(cast(Client, client))
    yield made
    made.close()


def test_a_motion_that_was_stopped_before_it_began_is_not_sent(
    connection: LeasedConnection, client: RecordingClient
) -> None:
    before = connection.stops
    connection.note_stop()
    with pytest.raises(MotionFailed, match="cancelled"):
        connection.run(PATH, before)
    assert "SubmitTrajectory" not in client.sent


def test_a_stop_that_arrives_just_before_the_trajectory_is_repeated(
    connection: LeasedConnection, client: RecordingClient
) -> None:
    client.while_sending = connection.note_stop
    connection.run(PATH, connection.stops)
    assert client.sent == ["AcquireLease", "Cancel", "SubmitTrajectory", "Cancel"]


def test_the_end_of_a_motion_is_not_cancelled(connection: LeasedConnection, client: RecordingClient) -> None:
    client.while_sending = connection.note_stop
    client.phases = ["cancelled"]
    with pytest.raises(MotionFailed):
        connection.run(PATH, connection.stops)
    assert client.sent[-1] == "SubmitTrajectory"


def test_a_goal_that_would_wait_for_another_call_is_not_sent(
    connection: LeasedConnection, client: RecordingClient
) -> None:
    entered = threading.Event()
    leave = threading.Event()

    def hold() -> None:
        entered.set()
        assert leave.wait(10.0)

    client.while_sending = hold
    motion = threading.Thread(target=connection.run, args=(PATH, connection.stops))
    motion.start()
    assert entered.wait(10.0)
    with pytest.raises(NoAnswer, match="under way"):
        connection.setpoint(connection.stops, valid_for=0.01)
    leave.set()
    motion.join()
    assert "Setpoint" not in client.sent


def test_the_answer_to_a_goal_is_waited_for_shortly(
    connection: LeasedConnection, client: RecordingClient
) -> None:
    connection.setpoint(connection.stops, valid_for=0.01)
    assert client.sent == ["AcquireLease", "Setpoint"] and client.patience == [2.0]


def arm_after_a_lost_lease(connection: LeasedConnection, client: RecordingClient) -> None:
    """Arm twice: refused for want of the lease, then obeyed."""
    finding = {"code": "LEASE_MISSING", "joint": None, "message": "no lease"}
    client.refusal = Refused("io.twind.Control.Refused", {"findings": [finding]})
    with pytest.raises(Refused):
        connection.command("Arm")
    client.refusal = None
    connection.command("Arm")


def test_a_lease_that_lapsed_is_taken_anew_by_the_next_call(
    connection: LeasedConnection, client: RecordingClient
) -> None:
    arm_after_a_lost_lease(connection, client)
    assert client.sent == ["AcquireLease", "Arm", "AcquireLease", "Arm"]


def test_the_lease_is_taken_from_another_holder_only_once(client: RecordingClient) -> None:
    asked: list[object] = []
    call = client.call

    def record(method: str, **parameters: Any) -> dict[str, Any]:
        if method == "AcquireLease":
            asked.append(parameters["take"])
        return call(method, **parameters)

    client.call = record  # type: ignore[method-assign]
    connection = LeasedConnection(cast(Client, client), take=True)
    arm_after_a_lost_lease(connection, client)
    connection.close()
    assert asked == [True, None]
