"""The words for what the daemon, the robot and the motion are doing (docs/safety.md)."""

from enum import StrEnum


class Mode(StrEnum):
    """Where commands go, and whether a writer exists."""

    SIM = "sim"  # bus not opened; commands go to the simulation
    MIRROR = "mirror"  # bus read only; commands go to the simulation
    LIVE = "live"  # bus read and write; commands go to the robot


class RobotState(StrEnum):
    """The robot and its bus. A port opens DISCONNECTED → IDENTIFYING → CONNECTED; torque from ARMED on."""

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


class Motion(StrEnum):
    """What the target of commands is doing."""

    IDLE = "idle"  # nobody holds: disarmed
    HOLDING = "holding"
    ACTIVE = "active"  # a trajectory runs
    STREAMING = "streaming"  # setpoints arrive
