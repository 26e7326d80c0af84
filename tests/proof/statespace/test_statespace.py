"""No history of commands, faults and deaths leaves torque without an owner, or a goal after a stop."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any

import pytest

from tests.proof.statespace.search import explore
from tests.proof.statespace.world import CORE, ModelWorld
from twind.loop.procedures import arming, daemon_shutdown, robot_condition, torque_release
from twind.loop.procedures.procedure_runner import ProcedureRunner
from twind.loop.procedures.torque_state import TorqueState
from twind.robot.modes import RobotState
from twind.safety import state_machine
from twind.safety.state_machine import RobotEvent

S = RobotState
E = RobotEvent
FAST = 4
END = "until no procedure runs"
SUPPORTS = ("gantry", "free")


@pytest.mark.parametrize("support", SUPPORTS)
def test_every_short_history_keeps_the_claims(support: str) -> None:
    result = explore(FAST, CORE, lambda: ModelWorld(support))
    print(result)
    assert not result.broken, result
    assert result.depth == FAST and result.states > 100, result


@pytest.mark.parametrize(
    "depth", [pytest.param(7, marks=pytest.mark.slow), pytest.param(12, marks=pytest.mark.campaign)]
)
@pytest.mark.parametrize("support", SUPPORTS)
def test_every_long_history_keeps_the_claims(support: str, depth: int) -> None:
    result = explore(depth, CORE, lambda: ModelWorld(support))
    print(result)
    assert not result.broken, result
    assert {"armed", "settling", "estop", "fault", "identifying"} <= result.seen, result


@pytest.mark.campaign
def test_every_short_history_of_all_steps_keeps_the_claims() -> None:
    result = explore(5)
    print(result)
    assert not result.broken, result


@pytest.mark.parametrize(
    "steps",
    [
        # A reset was obeyed while an e-stop ran: the next e-stop did not latch.
        "arm > tick > lower bus lost > e-stop settle > buses back > lower bus lost > reset > e-stop settle",
        # The other bus confirmed torque off, and that of the lost one was forgotten.
        "arm > tick > tick, requests fail > tick, requests fail > lower bus lost > tick > tick > buses back",
        # It was not ordered again after the return of the bus.
        "arm > tick > lower bus lost > buses back > tick > tick > tick",
        # SIGTERM ended the disarming of torque that was found on, and torque stayed.
        "arm > tick > tick > loop killed > disarm > SIGTERM",
        # A bus came back while the daemon released the others, and it ended with that torque on.
        "arm > tick > lower bus lost > SIGTERM > tick > buses back > tick, requests fail",
        # SIGTERM drove a servo that had not confirmed torque off after a cut ...
        f"arm > {END} > e-stop cut, requests fail > tick, requests fail > tick, requests fail > SIGTERM",
        # ... and a robot that was away during the cut.
        f"arm > {END} > lower bus lost > upper bus lost > e-stop cut > SIGTERM > buses back",
        # A bus was lost while SIGTERM lowered the robot, and the daemon ended without a wait for it.
        f"arm > {END} > SIGTERM > lower bus lost",
        # An ending daemon without torque need not latch a stop: its end must not be put off.
        "arm > lower bus lost > tick > reset > SIGTERM > buses back > e-stop settle",
    ],
)
def test_a_history_that_once_broke_a_claim_keeps_them(steps: str) -> None:
    world = ModelWorld()
    for name in (*steps.split(" > "), END, "tick"):
        if not world.loop.condition.finished:
            world.step(name)


# ---------------------------------------------------------------------- the search can fail


@contextmanager
def transition(event: RobotEvent, before: RobotState, after: RobotState | None) -> Iterator[None]:
    """One entry of the table leads elsewhere, or is gone."""
    entries = {state: each for state, each in state_machine.TABLE[event].items() if state is not before}
    if after is not None:
        entries[before] = after
    table: Mapping[Any, Any] = MappingProxyType(dict(state_machine.TABLE) | {event: entries})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(state_machine, "TABLE", table)
        patch.setattr(robot_condition, "TABLE", table)
        yield


TABLE_FAULTS = {
    "an e-stop is not latched": (E.ESTOP, S.ARMED, S.ARMED, ("tick", "arm", "e-stop settle")),
    "a lost bus is no fault": (E.FAULT, S.ARMED, S.ARMED, ("tick", "arm", "lower bus lost")),
    "a failed arming counts as armed": (
        E.ARM_FAILED,
        S.ARMING,
        S.ARMED,
        ("tick", "arm", "tick, requests fail"),
    ),
    "a reset ends armed": (E.RESET, S.ESTOP, S.ARMED, ("tick", "e-stop settle", "reset")),
    "a disarmed robot counts as armed": (E.SETTLED, S.SETTLING, S.ARMED, ("tick", "arm", "disarm")),
    "an armed robot counts as connected": (E.ARMED, S.ARMING, S.CONNECTED, ("tick", "arm")),
    "an e-stop is refused while settling": (
        E.ESTOP,
        S.SETTLING,
        None,
        ("tick", "arm", "disarm", "e-stop cut"),
    ),
}


@pytest.mark.parametrize("fault", TABLE_FAULTS)
def test_a_wrong_entry_of_the_table_is_found(fault: str) -> None:
    event, before, after, steps = TABLE_FAULTS[fault]
    with transition(event, before, after):
        result = explore(12, steps)
    print(fault, "->", result)
    assert result.broken


def _forgetting(name: str, *fields: tuple[str, Any]) -> tuple[Any, str, Any]:
    """A transition of the torque state that leaves fields as they should not be."""
    real = getattr(TorqueState, name)

    def wrong(torque: TorqueState, *args: Any) -> Any:
        done = real(torque, *args)
        for field, value in fields:
            setattr(torque, field, value)
        return done

    return TorqueState, name, wrong


def _nothing(*_args: Any, **_named: Any) -> Any:
    return iter(())


def _own_always(runner: Any, rank: Any, start: Any, ended: Any = lambda outcome: None) -> bool:
    return runner.rank is None and _OWN(runner, rank, start, ended)


_OWN = ProcedureRunner.own

CODE_FAULTS: dict[str, tuple[tuple[Any, str, Any], tuple[str, ...]]] = {
    "a release is not pending": (
        _forgetting("begin_release", ("_unconfirmed", False), ("_energising", False)),
        ("tick", "arm", "e-stop cut", "tick, requests fail"),
    ),
    "energising is not noted": (_forgetting("begin_energising", ("_energising", False)), ("tick", "arm")),
    "a lost bus is forgotten": (
        _forgetting("lose_bus", ("_pending_restore", False)),
        ("tick", "arm", "lower bus lost"),
    ),
    "the other bus confirms torque off for a lost one": (
        _forgetting("confirm_off", ("_unconfirmed", False)),
        ("tick", "arm", "lower bus lost", "buses back"),
    ),
    "a cut counts as a milder stop": (
        _forgetting("latch_stop", ("_stop_level", "settle"), ("_unconfirmed", False)),
        ("tick", "arm", "e-stop cut, requests fail", "SIGTERM"),
    ),
    "an ending daemon does not wait for a lost bus": (
        (daemon_shutdown, "AWAITED", -1.0),
        ("tick", "arm", "lower bus lost", "SIGTERM"),
    ),
    "an ending daemon forgets a bus that returns": (
        (daemon_shutdown, "retry_torque_off", _nothing),
        ("tick", "arm", "lower bus lost", "SIGTERM", "buses back"),
    ),
    "a failed arming leaves torque": (
        (arming, "switch_torque_off", _nothing),
        ("tick", "arm", "tick, requests fail"),
    ),
    "a release leaves torque": (
        (torque_release, "switch_torque_off", _nothing),
        ("tick", "arm", "disarm"),
    ),
    "a more urgent procedure waits": ((ProcedureRunner, "own", _own_always), ("tick", "arm", "e-stop cut")),
}


@pytest.mark.parametrize("fault", CODE_FAULTS)
def test_a_wrong_step_of_a_procedure_is_found(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    (where, name, wrong), steps = CODE_FAULTS[fault]
    monkeypatch.setattr(where, name, wrong)
    result = explore(12, steps)
    print(fault, "->", result)
    assert result.broken


def test_a_counterexample_is_a_shortest_history() -> None:
    with transition(E.RESET, S.ESTOP, S.ARMED):
        result = explore(12, CORE)
    assert len(result.path) == 3, "a stop, its end, and the reset"
    assert str(result).endswith(f"after: {' > '.join(result.path)}")
