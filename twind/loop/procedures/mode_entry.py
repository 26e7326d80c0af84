"""Entry of a mode: opens or closes the ports, and sets the start position of commands. Loop's process."""

from __future__ import annotations

import numpy as np

from twind.loop.procedures.procedure_context import ProcedureContext
from twind.robot.modes import Mode
from twind.safety.state_machine import LATCHED, RobotEvent
from twind.telemetry.command_latency import CommandLatencyTracer
from twind.twin.twin import Twin


class ModeEntry:
    """Changes the mode, once it may be changed."""

    def __init__(self, context: ProcedureContext, twin: Twin, way: CommandLatencyTracer) -> None:
        self._context = context
        self._twin = twin
        self._way = way

    def enter(self, mode: Mode) -> None:
        """Enter `mode`, also the present one: commands start from where the robot is now."""
        context = self._context
        condition = context.condition
        robot = context.robot
        condition.mode = mode
        robot.restart(None)
        self._way.forget()
        context.hardware.access(read=mode is not Mode.SIM, write=mode is Mode.LIVE)
        if mode is Mode.SIM and condition.state not in LATCHED:
            condition.change(RobotEvent.PORT_LOST)
        context.executor.idle()
        if mode is not Mode.LIVE:
            whole = mode is Mode.MIRROR and bool(np.isfinite(robot.measured.position).all())
            limits = robot.limits  # a robot without a calibration may read whole turns beyond them
            measured = np.clip(robot.measured.position, limits.hard_lower, limits.hard_upper)
            place = measured if whole else robot.simulated.position
            self._twin.place(place)
            context.executor.begin(place)
