"""Surroundings of a procedure: eight members of the loop, and nothing else of it. Loop's process."""

from __future__ import annotations

from typing import Protocol

from twind.loop.bus.hardware import Hardware
from twind.loop.ipc.responder import Responder
from twind.loop.procedures.controlled_robot import ControlledRobot
from twind.loop.procedures.procedure_runner import ProcedureRunner
from twind.loop.procedures.robot_condition import RobotCondition
from twind.loop.procedures.torque_state import TorqueState
from twind.motion.trajectory_executor import TrajectoryExecutor
from twind_drivers.clock import Clock


class ProcedureContext(Protocol):
    """Surroundings of a procedure. Further parts that one needs are arguments of its own."""

    @property
    def clock(self) -> Clock:
        """Monotonic time."""

    @property
    def hardware(self) -> Hardware:
        """All buses."""

    @property
    def executor(self) -> TrajectoryExecutor:
        """Commanded motion."""

    @property
    def robot(self) -> ControlledRobot:
        """Description and states of the joints, and the last goal."""

    @property
    def condition(self) -> RobotCondition:
        """Mode, state and latches."""

    @property
    def torque(self) -> TorqueState:
        """Torque that this daemon has ordered."""

    @property
    def procedures(self) -> ProcedureRunner:
        """Procedures that run now."""

    @property
    def reports(self) -> Responder:
        """Replies and events."""
