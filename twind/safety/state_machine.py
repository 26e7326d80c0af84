"""The states of robot and bus, and their transitions (docs/safety.md). A table: no clock, no device.

FAULT and ESTOP latch. A latch outlives a lost port, so `StateLatch` carries it beside the state.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, Motion, RobotState


class RobotEvent(StrEnum):
    """Events that change the robot's state."""

    PORT_OPENED = "port opened"
    IDENTIFIED = "identified"
    CALIBRATE = "calibrate"
    CALIBRATED = "calibrated"
    ARM = "arm"
    ARMED = "armed"
    ARM_FAILED = "arm failed"
    SETTLE = "settle"  # disarm, the end of a program, SIGTERM
    SETTLED = "settled"  # torque read back off
    FAULT = "fault"
    ESTOP = "e-stop"
    RESET = "reset"  # every latched code acknowledged, its cause gone, torque off
    PORT_LOST = "port lost"
    INHIBIT = "inhibit"


LATCHED = (RobotState.FAULT, RobotState.ESTOP)

_S = RobotState
_STAYS = {_S.FAULT: _S.FAULT, _S.ESTOP: _S.ESTOP}  # a latched state lets a running procedure end
_ANY = tuple(RobotState)

TABLE: Mapping[RobotEvent, Mapping[RobotState, RobotState]] = MappingProxyType(
    {
        RobotEvent.PORT_OPENED: {_S.DISCONNECTED: _S.IDENTIFYING} | _STAYS,
        RobotEvent.IDENTIFIED: {_S.IDENTIFYING: _S.CONNECTED} | _STAYS,
        # A register can prevent identification, so calibrating is allowed without it.
        RobotEvent.CALIBRATE: {_S.CONNECTED: _S.CALIBRATING, _S.IDENTIFYING: _S.CALIBRATING},
        RobotEvent.CALIBRATED: {_S.CALIBRATING: _S.CONNECTED} | _STAYS,
        RobotEvent.ARM: {_S.CONNECTED: _S.ARMING},
        RobotEvent.ARMED: {_S.ARMING: _S.ARMED},
        # A failed arming is reported after the fault or the lost port that caused it.
        RobotEvent.ARM_FAILED: {
            _S.ARMING: _S.CONNECTED,
            _S.DISCONNECTED: _S.DISCONNECTED,
            _S.IDENTIFYING: _S.IDENTIFYING,
            _S.CONNECTED: _S.CONNECTED,
            _S.SETTLING: _S.SETTLING,
            _S.INHIBITED: _S.INHIBITED,
        }
        | _STAYS,
        # Torque off is never refused where anything can be written at all.
        RobotEvent.SETTLE: {
            _S.IDENTIFYING: _S.SETTLING,  # torque found on at start
            _S.CONNECTED: _S.SETTLING,
            _S.CALIBRATING: _S.SETTLING,
            _S.ARMING: _S.SETTLING,
            _S.ARMED: _S.SETTLING,
            _S.SETTLING: _S.SETTLING,
        }
        | _STAYS,
        RobotEvent.SETTLED: {
            _S.SETTLING: _S.CONNECTED,
            _S.DISCONNECTED: _S.DISCONNECTED,
            _S.IDENTIFYING: _S.IDENTIFYING,
            _S.CONNECTED: _S.CONNECTED,
            _S.INHIBITED: _S.INHIBITED,
        }
        | _STAYS,
        RobotEvent.FAULT: dict.fromkeys(_ANY, _S.FAULT) | {_S.ESTOP: _S.ESTOP, _S.INHIBITED: _S.INHIBITED},
        RobotEvent.ESTOP: dict.fromkeys(_ANY, _S.ESTOP) | {_S.INHIBITED: _S.INHIBITED},
        # After an inhibit the bus must be identified anew: as if the port had been lost.
        RobotEvent.RESET: {
            _S.FAULT: _S.CONNECTED,
            _S.ESTOP: _S.CONNECTED,
            _S.DISCONNECTED: _S.DISCONNECTED,
            _S.IDENTIFYING: _S.IDENTIFYING,
            _S.CONNECTED: _S.CONNECTED,
            _S.INHIBITED: _S.DISCONNECTED,
        },
        RobotEvent.PORT_LOST: dict.fromkeys(_ANY, _S.DISCONNECTED),
        RobotEvent.INHIBIT: dict.fromkeys(_ANY, _S.INHIBITED),
    }
)


def step(state: RobotState, event: RobotEvent) -> RobotState:
    """Return the state after `event`. Raises RuntimeError, which lists the states that allow it."""
    follows = TABLE[event]
    if state not in follows:
        raise _not_allowed(state, event)
    return follows[state]


def _not_allowed(state: RobotState, event: RobotEvent) -> RuntimeError:
    names = ", ".join(TABLE[event])
    return RuntimeError(f"{event.value} is not possible while {state.value}; allowed while {names}")


@dataclass(frozen=True, slots=True)
class StateLatch:
    """The state with its memory: a latch survives a lost port, and only a reset clears it."""

    state: RobotState = RobotState.DISCONNECTED
    latched: bool = False
    identified: bool = False  # the bus is open and all its devices are identified

    def after(self, event: RobotEvent) -> "StateLatch":
        """Return the state after `event`. Raises RuntimeError."""
        state = step(self.state, event)
        if event is RobotEvent.CALIBRATE and self.latched:  # from before the port was lost
            raise _not_allowed(RobotState.FAULT, event)
        latched = (
            self.latched or event in (RobotEvent.FAULT, RobotEvent.ESTOP)
        ) and event is not RobotEvent.RESET
        identified = self.identified
        if event is RobotEvent.IDENTIFIED:
            identified = True
        elif event in (RobotEvent.PORT_LOST, RobotEvent.INHIBIT):
            identified = False
        if state in (RobotState.CONNECTED, RobotState.SETTLING) and latched:
            state = RobotState.FAULT  # back on a port that was lost with a latch set
        ended = event in (RobotEvent.RESET, RobotEvent.SETTLED, RobotEvent.CALIBRATED)
        if ended and state is RobotState.CONNECTED and not identified:
            state = RobotState.DISCONNECTED
        return StateLatch(state, latched, identified)


def mode_change(before: Mode, after: Mode, state: RobotState, motion: Motion) -> Finding | None:
    """Return why the mode may not change now; None: it may. A simulated motion is cancelled by the change.

    From mirror to live also under a latch and while a device is missing: torque that was found on can be
    switched off in live alone.
    """
    if before is after:
        return None
    released = state in (*LATCHED, RobotState.IDENTIFYING) and (before, after) == (Mode.MIRROR, Mode.LIVE)
    if not released and state not in (RobotState.DISCONNECTED, RobotState.CONNECTED):
        message = (
            f"the mode changes only while disconnected or connected, not {state.value}: {_remedy(state)}"
        )
        return Finding(ReasonCode.MODE_DENIES, message=message)
    if before is Mode.LIVE and motion is not Motion.IDLE:
        return Finding(ReasonCode.MODE_DENIES, message=f"the robot is {motion.value}: disarm first")
    return None


def _remedy(state: RobotState) -> str:
    if state in (*LATCHED, RobotState.INHIBITED):
        return "disarm and reset first"
    if state is RobotState.CALIBRATING:
        return "end the calibration first"
    return "disarm first" if state in (RobotState.ARMING, RobotState.ARMED) else "wait until it is done"
