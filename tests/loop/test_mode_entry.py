"""Entry of a mode: which ports it opens, and from where commands go on. On scripted buses."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.procedure_rig import PLACE, REST, WHY, ProcedureRig
from twind.loop.procedures.mode_entry import ModeEntry
from twind.robot.modes import Mode, Motion, RobotState
from twind.safety.state_machine import RobotEvent

SIMULATED = np.array([-0.3, 0.2, 0.1])


class Entry(ProcedureRig):
    """A robot at `PLACE` beside a simulation that is elsewhere. A goal was sent before."""

    def __init__(self) -> None:
        super().__init__()
        self.robot.simulated = self.state(SIMULATED)
        self.robot.written = REST
        self.placed: list[np.ndarray] = []
        self.forgotten = 0
        twin: Any = SimpleNamespace(place=self.placed.append)
        way: Any = SimpleNamespace(forget=self._forget)
        self.modes = ModeEntry(self, twin, way)

    def _forget(self) -> None:
        self.forgotten += 1

    def entered(self, mode: Mode) -> None:
        self.modes.enter(mode)
        assert self.condition.mode is mode
        assert self.robot.written is None
        assert self.forgotten == 1

    def begins_at(self, place: np.ndarray) -> None:
        """Simulation and commands go on from there."""
        [placed] = self.placed
        assert placed.tolist() == place.tolist()
        assert self.executor.reference.position.tolist() == place.tolist()


@pytest.fixture
def rig() -> Entry:
    return Entry()


def test_sim_closes_the_ports_and_goes_on_from_the_simulated_pose(rig: Entry) -> None:
    rig.entered(Mode.SIM)
    assert rig.hardware.log == ["access read False write False"]
    assert rig.condition.state is RobotState.DISCONNECTED
    assert not rig.condition.identified
    rig.begins_at(SIMULATED)


@pytest.mark.parametrize(
    ("event", "state"), [(RobotEvent.FAULT, RobotState.FAULT), (RobotEvent.ESTOP, RobotState.ESTOP)]
)
def test_a_latched_state_stays_in_sim(rig: Entry, event: RobotEvent, state: RobotState) -> None:
    rig.condition.latch(WHY)
    rig.condition.change(event)
    rig.entered(Mode.SIM)
    assert rig.condition.state is state


def test_sim_entered_without_a_port_reports_no_change(rig: Entry) -> None:
    rig.condition.change(RobotEvent.PORT_LOST)
    rig.book.events.clear()
    rig.entered(Mode.SIM)
    assert rig.condition.state is RobotState.DISCONNECTED
    assert rig.book.events == []


def test_mirror_opens_the_ports_to_read_alone_and_goes_on_from_the_measured_pose(rig: Entry) -> None:
    rig.entered(Mode.MIRROR)
    assert rig.hardware.log == ["access read True write False"]
    assert rig.condition.state is RobotState.CONNECTED
    rig.begins_at(PLACE)


def test_mirror_goes_on_from_the_simulated_pose_while_the_place_of_a_joint_is_unknown(rig: Entry) -> None:
    rig.read(position=np.array([0.4, np.nan, -0.5]))
    rig.entered(Mode.MIRROR)
    rig.begins_at(SIMULATED)


def test_a_measured_pose_beyond_the_hard_limits_is_simulated_at_them(rig: Entry) -> None:
    limits = rig.robot.limits
    rig.read(position=np.array([9.0, 0.5, -9.0]))
    rig.entered(Mode.MIRROR)
    rig.begins_at(np.array([limits.hard_upper[0], 0.5, limits.hard_lower[2]]))


def test_live_opens_the_ports_to_write_and_commands_nothing(rig: Entry) -> None:
    rig.executor.begin(SIMULATED)
    rig.entered(Mode.LIVE)
    assert rig.hardware.log == ["access read True write True"]
    assert rig.condition.state is RobotState.CONNECTED
    assert rig.placed == []
    assert rig.executor.reference is None
    assert rig.executor.motion is Motion.IDLE


def test_a_simulated_motion_ends_with_its_mode(rig: Entry) -> None:
    rig.executor.begin(REST)
    rig.executor.yield_to(PLACE, 0.5)
    rig.entered(Mode.SIM)
    rig.begins_at(SIMULATED)
    assert rig.executor.motion is Motion.HOLDING
    for tick in range(5):
        goal = rig.executor.goal(rig.clock.now() + 0.01 * tick)
        assert goal.position.tolist() == SIMULATED.tolist()
