"""Rig of the guard's tests: a live robot of three joints without a fault."""

from dataclasses import replace
from math import nan

import numpy as np

from tests.support.gate_rig import at_rest, limits
from twind.robot.arrays import Floats
from twind.robot.finding import ReasonCode
from twind.robot.joint_state import JointState
from twind.robot.modes import Mode, Motion, RobotState
from twind.safety.guard import Guard, GuardDecision, GuardInput

N = 3
LIMITS = limits(N)  # ±2 rad, hard ±2.05, 4 rad/s
PERIOD = 0.01
STEP = 4.0 * PERIOD
TINY = 1e-6
FINE = GuardDecision()


def reading(
    position: list[float] | None = None, age: list[float] | None = None, time: float = 10.0
) -> JointState:
    still = np.zeros(N)
    return JointState(
        time,
        still if position is None else np.array(position),
        still,
        still * nan,
        still if age is None else np.array(age),
        np.ones(N, bool),
    )


def facts(**over: object) -> GuardInput:
    """Live, armed, following a trajectory, all well."""
    usual = GuardInput(
        now=10.0,
        mode=Mode.LIVE,
        state=RobotState.ARMED,
        motion=Motion.ACTIVE,
        period=PERIOD,
        lateness=0.0001,
        missed_in_a_row=0,
        measured=reading(),
        goal=at_rest([0.0] * N),
        previous=np.zeros(N),
        lease_ok=True,
        setpoint_age=None,
        torque=np.ones(N, np.int8),
        torque_expected=True,
        torque_settled=True,
        watchdog=np.full(N, 5, np.int16),
        status_time=np.full(N, 9.99),
        discarded=0,
        traffic=(),
        alerts=np.zeros(N, np.uint8),
        fault=np.zeros(N, np.int16),
        tick=np.full(N, -1, np.int32),
        health_time=np.full(N, float(over.get("now", 10.0)) - 0.05),  # type: ignore[arg-type]
        temperature=np.full(N, 30.0),
        voltage=np.full(N, 12.0),
        jumps=np.zeros(N, np.int64),
        leaps=np.zeros(N),
    )
    return replace(usual, **over)


def judge(**over: object) -> GuardDecision:
    return Guard(LIMITS).judge(facts(**over))


def codes(decision: GuardDecision) -> list[ReasonCode]:
    return [finding.code for finding in decision.findings]


def joints(*values: float) -> Floats:
    return np.array(values)
