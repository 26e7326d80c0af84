"""The state `calibrating`: who begins it, when it ends, and who may write EEPROM, without buses."""

from typing import Any

import numpy as np
import pytest

from tests.support.procedure_rig import ProcedureRig
from twind import link
from twind.loop.procedures.calibrating_state import CalibratingState
from twind.loop.procedures.procedure_runner import Priority, Procedure
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, RobotState
from twind.safety.lease import Lease
from twind.safety.state_machine import RobotEvent

CLIENT, OTHER = 7, 9
NO_LEASE = Finding(ReasonCode.LEASE_MISSING, message="this connection does not hold the lease")


class Scene:
    """A robot in `connected`, whose lease a client holds."""

    def __init__(self) -> None:
        self.rig = ProcedureRig()
        self.lease = Lease()
        self.settled: list[float] = []
        self.rig.hardware.slow.torque[:] = 0
        identity: Any = self
        self.state = CalibratingState(self.rig, self.lease, identity)
        self.acquire(CLIENT)

    def settle_state(self, now: float) -> None:
        self.settled.append(now)

    @property
    def now(self) -> float:
        return self.rig.clock.now()

    def acquire(self, client: int) -> None:
        assert self.lease.acquire(client, "ann", 0, self.now, take=True)

    def ask(self, on: bool = True, client: int = CLIENT) -> tuple[str | None, dict[str, Any]]:
        """The reply."""
        self.state.ask(link.Calibrate(ticket=1, client=client, on=on), self.now)
        reply = self.rig.book.replies.pop()
        assert self.rig.book.replies == []
        return reply.error, dict(reply.parameters)

    def begun(self) -> "Scene":
        assert self.ask() == (None, {"state": "calibrating"})
        self.rig.book.events.clear()
        return self

    def end_if_due(self) -> RobotState:
        self.state.end_if_due(self.now)
        return self.rig.condition.state

    def wait(self, seconds: float) -> None:
        self.rig.clock.sleep_until(self.now + seconds)


@pytest.fixture
def scene() -> Scene:
    return Scene()


def waits() -> Procedure:
    while True:
        yield


# ------------------------------------------------------------------------------- begun and ended


def test_it_begins_and_ends_on_request(scene: Scene) -> None:
    assert not scene.state.on
    assert scene.ask() == (None, {"state": "calibrating"})
    assert scene.state.on and scene.end_if_due() is RobotState.CALIBRATING
    assert scene.ask(False) == (None, {"state": "connected"})
    assert not scene.state.on and scene.settled == [scene.now]


@pytest.mark.parametrize("on", [True, False])
def test_a_request_for_the_present_state_is_no_error_and_renews_the_lease(scene: Scene, on: bool) -> None:
    if on:
        scene.begun()
    scene.wait(0.9)
    assert scene.ask(on) == (None, {"state": "calibrating" if on else "connected"})
    scene.wait(0.9)
    assert scene.lease.held_by(CLIENT, scene.now) and scene.state.on == on
    assert scene.settled == []


@pytest.mark.parametrize("on", [True, False])
def test_it_requires_the_lease(scene: Scene, on: bool) -> None:
    assert scene.ask(on, OTHER) == ("Refused", {"findings": [NO_LEASE]})
    assert not scene.state.on


def test_what_was_ended_before_identification_is_identified_before_the_reply(scene: Scene) -> None:
    scene.rig.condition.change(RobotEvent.PORT_LOST)
    scene.rig.condition.change(RobotEvent.PORT_OPENED)
    scene.begun()
    scene.settle_state = lambda now: scene.rig.condition.change(RobotEvent.PORT_OPENED)  # type: ignore[method-assign]
    assert scene.ask(False) == (None, {"state": "identifying"})


@pytest.mark.parametrize("on", [True, False])
def test_it_is_busy_during_a_procedure(scene: Scene, on: bool) -> None:
    if not on:
        scene.begun()
    scene.rig.own(Priority.ARM, waits)
    assert scene.ask(on) == ("Busy", {"what": "arm"})
    assert scene.state.on is not on


def sim(scene: Scene) -> None:
    scene.rig.condition.mode = Mode.SIM


def armed(scene: Scene) -> None:
    scene.rig.condition.change(RobotEvent.ARM)


def latched(scene: Scene) -> None:
    scene.rig.condition.latch(Finding(ReasonCode.OVERCURRENT, 0))
    scene.rig.condition.latch(Finding(ReasonCode.FOLLOW_ERR, 0))


def latched_before_its_port_was_lost(scene: Scene) -> None:
    scene.rig.condition.change(RobotEvent.FAULT)
    scene.rig.condition.change(RobotEvent.PORT_LOST)
    scene.rig.condition.change(RobotEvent.PORT_OPENED)


def held(scene: Scene) -> None:
    scene.rig.torque.take_hold(np.ones(3, np.bool_))


def found_on(scene: Scene) -> None:
    scene.rig.hardware.slow.torque[2] = 1


def closed(scene: Scene) -> None:
    scene.rig.hardware.ports[1].reader = None


def closed_with_trouble(scene: Scene) -> None:
    closed(scene)
    scene.rig.hardware.ports[1].trouble = "no such file"


@pytest.mark.parametrize(
    ("prepare", "error", "parameters"),
    [
        (sim, "WrongState", {"state": "mode sim", "allowed": ["mode mirror", "mode live"]}),
        (armed, "WrongState", {"state": "arming", "allowed": ["connected", "identifying"]}),
        (
            latched,
            "WrongState",
            {"state": "connected, latched: OVERCURRENT, FOLLOW_ERR", "allowed": ["reset"]},
        ),
        (
            latched_before_its_port_was_lost,
            "WrongState",
            {"state": "identifying, latched: ", "allowed": ["reset"]},
        ),
        (held, "WrongState", {"state": "connected, torque on", "allowed": ["disarmed"]}),
        (found_on, "WrongState", {"state": "connected, torque on", "allowed": ["disarmed"]}),
        (closed, "BusFailed", {"bus": "upper", "message": "the bus is not open"}),
        (closed_with_trouble, "BusFailed", {"bus": "upper", "message": "no such file"}),
    ],
)
def test_what_prevents_it_is_named(
    scene: Scene, prepare: Any, error: str, parameters: dict[str, Any]
) -> None:
    prepare(scene)
    before = scene.rig.condition.state
    assert scene.ask() == (error, parameters)
    assert scene.rig.condition.state is before


# ------------------------------------------------------------------------------- ended by itself


def test_it_ends_with_its_lease(scene: Scene) -> None:
    scene.begun()
    scene.wait(1.0)
    assert scene.end_if_due() is RobotState.CALIBRATING
    scene.wait(0.01)
    assert scene.end_if_due() is RobotState.CONNECTED
    lost, change = scene.rig.book.events
    assert (lost.level, lost.code) == ("warning", ReasonCode.LEASE_LOST)
    assert lost.message == "the lease is gone: the calibration ends"
    assert change.code == "connected" and scene.settled == [scene.now]
    scene.end_if_due()
    assert len(scene.rig.book.events) == 2


def test_it_ends_when_another_client_takes_the_lease(scene: Scene) -> None:
    scene.begun()
    scene.acquire(OTHER)
    assert scene.end_if_due() is RobotState.CONNECTED


def test_a_client_that_takes_the_lease_and_asks_for_it_goes_on_calibrating(scene: Scene) -> None:
    """Its reply says so; the state of the lease before would end in the same tick."""
    scene.begun()
    scene.acquire(OTHER)
    assert scene.ask(client=OTHER) == (None, {"state": "calibrating"})
    assert scene.end_if_due() is RobotState.CALIBRATING


@pytest.mark.parametrize("place", [0, 1])
def test_it_ends_when_a_port_is_lost(scene: Scene, place: int) -> None:
    scene.begun()
    scene.rig.hardware.ports[place].reader = None
    assert scene.end_if_due() is RobotState.DISCONNECTED
    assert [event.code for event in scene.rig.book.events] == ["disconnected"]


def test_it_does_not_end_during_a_procedure(scene: Scene) -> None:
    scene.begun()
    scene.rig.own(Priority.HOME, waits)
    scene.wait(2.0)
    assert scene.end_if_due() is RobotState.CALIBRATING
    scene.rig.procedures.abandon()
    assert scene.end_if_due() is RobotState.CONNECTED


@pytest.mark.parametrize("event", [RobotEvent.FAULT, RobotEvent.PORT_LOST])
def test_another_state_is_left_alone(scene: Scene, event: RobotEvent) -> None:
    scene.rig.condition.change(event)
    scene.lease.release(CLIENT)
    scene.rig.book.events.clear()
    before = scene.rig.condition.state
    assert scene.end_if_due() is before and scene.rig.book.events == []


# ------------------------------------------------------------------------------- EEPROM


def asks(scene: Scene, kept: bool = True, client: int = CLIENT) -> Any:
    command = link.WriteRegister(ticket=1, client=client, bus="lower", id=3, name="id", value=1)
    return scene.state.refusal_to_keep(command, kept, scene.now)


def test_only_who_holds_the_lease_writes_eeprom_while_calibrating(scene: Scene) -> None:
    refused = asks(scene)
    assert refused.error == "WrongState"
    state = "connected, and id of id 3 is EEPROM"
    assert refused.parameters == {"state": state, "allowed": ["calibrating"]}
    scene.begun()
    assert asks(scene) is None
    message = "another client calibrates: only the lease holder may write EEPROM"
    assert asks(scene, client=OTHER).findings == (Finding(ReasonCode.LEASE_MISSING, message=message),)


def test_a_write_to_eeprom_renews_the_lease(scene: Scene) -> None:
    scene.begun()
    scene.wait(0.9)
    assert asks(scene) is None
    scene.wait(0.9)
    assert scene.end_if_due() is RobotState.CALIBRATING


@pytest.mark.parametrize("client", [CLIENT, OTHER])
def test_a_register_that_power_off_clears_is_written_in_any_state(scene: Scene, client: int) -> None:
    assert asks(scene, kept=False, client=client) is None
    scene.begun()
    assert asks(scene, kept=False, client=client) is None
