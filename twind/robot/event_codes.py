"""Codes of events and log lines that are no reason codes. Pure; the values are part of the interface."""

from enum import StrEnum

from twind.robot.finding import ReasonCode
from twind.robot.modes import RobotState


class EventCode(StrEnum):
    """Code of an event or a log line that reports what happened, and no reason of a refusal or a reaction."""

    # Events of the loop
    START = "START"
    STOPPING = "STOPPING"  # the end is requested
    END = "END"  # the last event of a daemon
    FAILSAFE = "FAILSAFE"  # progress of `twind --failsafe`
    RELOADED = "RELOADED"  # settings changed: the description of the robot may differ
    RELOAD_REFUSED = "RELOAD_REFUSED"
    PORT_WARNING = "PORT_WARNING"  # a port works with a defect
    LATENCY_CALM = "LATENCY_CALM"  # a latency is below its bound again
    GAP_GROWN = "GAP_GROWN"  # a joint follows the model worse than when it was identified
    GAP_STOPPED = "GAP_STOPPED"  # no process works out the gap
    MOTION = "MOTION"  # a trajectory ended; `phase` says how
    PACE = "PACE"  # the motion is slowed
    SETTLE = "SETTLE"  # the way to the rest pose did not go as planned
    DAMP = "DAMP"
    HOMING = "HOMING"
    REGISTER = "REGISTER"  # a register was written by request
    REBOOT = "REBOOT"  # a device was restarted by request
    EPISODE_BEGIN = "EPISODE_BEGIN"  # annotations of clients
    EPISODE_END = "EPISODE_END"
    NOTE = "NOTE"
    # Log lines of the front process
    LATENCY = "latency"  # the overview every five seconds
    LOOKAHEAD = "LOOKAHEAD"  # pairs of bodies that the precheck covers
    LOOP_SILENT = "LOOP_SILENT"  # the loop did not answer in time
    SLOW_READER = "SLOW_READER"  # a client was disconnected
    ONEWAY_FLOOD = "ONEWAY_FLOOD"  # calls without a reply came too fast
    DESCRIPTORS = "DESCRIPTORS"  # no descriptor is left for new clients
    CALL_BROKE = "CALL_BROKE"  # a defect in a call
    FRONT_BROKE = "FRONT_BROKE"  # a defect outside calls
    FLIGHT_WRITTEN = "FLIGHT_WRITTEN"
    FLIGHT_NOT_WRITTEN = "FLIGHT_NOT_WRITTEN"
    FLIGHT_LEFT_OUT = "FLIGHT_LEFT_OUT"  # too soon after the last file
    LINES_LOST = "LINES_LOST"  # log lines that could not be written


# Code of any event: a change of state has the new state, a warning or a fault its reason.
AnyEventCode = EventCode | ReasonCode | RobotState
