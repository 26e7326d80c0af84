"""Modes of the daemon, states of the robot and of its motion (docs/safety.md)."""

from enum import StrEnum


class Mode(StrEnum):
    """Target of commands, and whether a writer exists."""

    SIM = "sim"  # bus not opened; commands go to the simulation
    MIRROR = "mirror"  # bus read only; commands go to the simulation
    LIVE = "live"  # bus read and write; commands go to the robot


class RobotState(StrEnum):
    """State of the robot and its bus: DISCONNECTED → IDENTIFYING → CONNECTED; torque from ARMED on."""

    DISCONNECTED = "disconnected"
    IDENTIFYING = "identifying"
    CONNECTED = "connected"
    CALIBRATING = "calibrating"
    ARMING = "arming"
    ARMED = "armed"
    SETTLING = "settling"
    FAULT = "fault"  # latched
    ESTOP = "estop"  # latched
    INHIBITED = "inhibited"  # nothing more is written


# states that only a reset ends
RESET_STATES = frozenset({RobotState.FAULT, RobotState.ESTOP, RobotState.INHIBITED})


class Motion(StrEnum):
    """Motion of the target of commands."""

    IDLE = "idle"  # disarmed: no goal is held
    HOLDING = "holding"
    ACTIVE = "active"  # a trajectory runs
    STREAMING = "streaming"  # setpoints arrive
