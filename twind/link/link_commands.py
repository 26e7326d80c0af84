"""What the front asks of the loop. Joints are indices, times the loop's monotonic seconds."""

from collections.abc import Sequence
from typing import Any

import msgspec

from twind.robot.finding import Finding


class LinkMessage(msgspec.Struct, frozen=True, kw_only=True, tag=True, tag_field="kind"):
    """What every message has: a `kind` that names its type."""


class Command(LinkMessage, frozen=True, kw_only=True, tag=True, tag_field="kind"):
    """A call of one client. Replies carry its ticket; the lease is bound to its connection."""

    ticket: int
    client: int  # number of the connection, > 0, never used again
    uid: int = -1
    holder: str = ""  # how the client is named to others: "uid 1000, pid 4711"
    received: float | None = None  # s, the whole call was in the front and it was its turn; None: unknown


class SetMode(Command, frozen=True, kw_only=True):
    """Change where commands go. Reply: {mode}."""

    mode: str


class AcquireLease(Command, frozen=True, kw_only=True):
    """Take the lease; `take` wrests it from another (motion holds first). Reply: {lease}."""

    take: bool = False


class RenewLease(Command, frozen=True, kw_only=True):
    """Keep the lease. Reply: {lease}."""


class ReleaseLease(Command, frozen=True, kw_only=True):
    """Give the lease back. Reply: {}."""


class Arm(Command, frozen=True, kw_only=True):
    """Goal := present, read back, then torque. Reply when armed: {joints: [index]}."""

    joints: Sequence[int] | None = None
    edited: Sequence[str] = ()  # files of the robot that were written anew since they were read


class Disarm(Command, frozen=True, kw_only=True):
    """Settle, then torque off. Reply when done: {state}."""


class EStop(Command, frozen=True, kw_only=True):
    """Stop now. First reply when its first effect is confirmed on the bus: {state, torque_off, done}."""

    level: str = "settle"
    reason: str = ""
    more: bool = False


class Reset(Command, frozen=True, kw_only=True):
    """Acknowledge latched faults. Reply: {state}."""

    codes: Sequence[str] | None = None


class Calibrate(Command, frozen=True, kw_only=True):
    """Begin or end `calibrating`. Needs the lease, and ends with it. Reply: {state}."""

    on: bool


class Submit(Command, frozen=True, kw_only=True):
    """A trajectory; its arrays in the memfd beside this datagram (`pack_path`).

    `check_only`: reply {verdict}, nothing moves. Else with `more`: {phase, progress, verdict?, findings?}
    from `accepted` to one of succeeded, cancelled, replaced, aborted; without: one reply at `accepted`.
    """

    id: str
    points: int
    commanded: Sequence[int]
    velocity: bool = False
    acceleration: bool = False
    start_in: float = 0.0
    goal_time: float | None = None
    tolerances: Sequence[tuple[int, float | None, float | None]] = ()  # (joint, path, goal), rad
    policy: str = "reject"
    append_stop: bool = False
    check_only: bool = False
    more: bool = False
    front_checked: float = 0.0  # s, when the state was true that the front judged its share from
    generation: int = 0  # of the limits that the front judged by
    refused: Sequence[
        Finding
    ] = ()  # what the front found: clearance, torque, balance (SELF_COLLISION to UNSTABLE_POSE)
    warned: Sequence[Finding] = ()


class Cancel(Command, frozen=True, kw_only=True):
    """Decelerate and hold. Needs no lease. Reply: {state}."""


class Setpoint(Command, frozen=True, kw_only=True):
    """One streamed goal. Reply: {sequence, changes}."""

    joints: Sequence[int]
    positions: Sequence[float]
    velocities: Sequence[float] | None = None
    valid_for: float = 0.1
    allow_clamp: bool = False


class ReadRegister(Command, frozen=True, kw_only=True):
    """One register of one device. Reply: {register}."""

    bus: str
    id: int
    name: str


class WriteRegister(Command, frozen=True, kw_only=True):
    """Write and read back; only while disarmed, EEPROM only while calibrating. Reply: {register}."""

    bus: str
    id: int
    name: str
    value: int


class Reboot(Command, frozen=True, kw_only=True):
    """Restart one device; only while disarmed. Reply: {state, restored, differing}: RAM settings in words."""

    bus: str
    id: int


class Scan(Command, frozen=True, kw_only=True):
    """Ping every id of a bus. One reply (continues) per device found: {bus, id, model, ...}."""

    bus: str | None = None


class FindStop(Command, frozen=True, kw_only=True):
    """Drive one joint against its stop, so many times; only while calibrating, in live.

    Replies with `more`: {phase, progress}; the last one of all: {ticks} found, or {findings} failed, besides.
    """

    joint: int
    side: str  # lower or upper
    current_share: float | None = None  # of its current limit
    speed: float | None = None  # rad/s
    times: int | None = None
    more: bool = False


class Annotation(msgspec.Struct, frozen=True):
    """What somebody says of what the robot is doing, as `Annotation` of the interface."""

    kind: str  # begin, end, note
    task: str | None = None
    success: bool | None = None
    text: str | None = None


class Mark(Command, frozen=True, kw_only=True):
    """Say this as an event, for the log and all that is recorded. Reply: {sequence}."""

    annotation: Annotation


class ApplyChanges(Command, frozen=True, kw_only=True, tag="Adopt"):
    """Changes that both sides make at one moment (`config/hot_changes.py`); the next front's briefing in the
    memfd.

    Reply: {applied: [key], needs_restart: [key]}.
    """

    generation: int  # of that briefing: one more than the one in force
    changes: dict[str, Any]
    needs_restart: Sequence[str] = ()
    reread: bool = True  # by files read again; False: by a client's word


class ReloadStarted(LinkMessage, frozen=True, kw_only=True, tag="Rereading"):
    """The front begins to read the files again."""


class ReloadFailed(LinkMessage, frozen=True, kw_only=True, tag="RereadFailed"):
    """What was wrong with the files; nothing changes."""

    message: str


class ConnectionClosed(LinkMessage, frozen=True, kw_only=True, tag="Gone"):
    """A connection closed: its lease lapses, its unanswered tickets are void."""

    client: int


class Rebound(LinkMessage, frozen=True, kw_only=True):
    """A listening socket was bound again, as its file was gone. Its descriptor comes beside this datagram."""

    name: str  # control or observe
    label: str  # of the `Listener`


class Reachable(LinkMessage, frozen=True, kw_only=True):
    """Whether clients can connect. The first message of a front about it, and one for every change."""

    missing: str = ""  # which socket cannot be reached, why, and the remedy; "": every socket is in place
    rebound: Sequence[str] = ()  # paths of the sockets that were bound again since the last message


class CrashRecordingDone(LinkMessage, frozen=True, kw_only=True, tag="WreckDone"):
    """What a daemon before this one left is written down, or cannot be: it need not be kept any longer."""


class Heartbeat(LinkMessage, frozen=True, kw_only=True):
    """The front lives; at least twice a second."""


Inward = (
    SetMode
    | AcquireLease
    | RenewLease
    | ReleaseLease
    | Arm
    | Disarm
    | EStop
    | Reset
    | Calibrate
    | FindStop
    | Submit
    | Cancel
    | Setpoint
    | ReadRegister
    | WriteRegister
    | Reboot
    | Scan
    | Mark
    | ApplyChanges
    | ReloadStarted
    | ReloadFailed
    | ConnectionClosed
    | Rebound
    | Reachable
    | CrashRecordingDone
    | Heartbeat
)
