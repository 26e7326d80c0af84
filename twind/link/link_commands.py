"""Commands and notices of the front to the loop. Joints are indices, times the loop's monotonic seconds."""

from collections.abc import Sequence
from typing import Any

import msgspec

from twind.robot.finding import Finding


class LinkMessage(msgspec.Struct, frozen=True, kw_only=True, tag=True, tag_field="kind"):
    """Base of all messages: a `kind` names the type."""


class Command(LinkMessage, frozen=True, kw_only=True, tag=True, tag_field="kind"):
    """A call of one client. Replies carry its ticket; the lease is bound to its connection."""

    ticket: int
    client: int  # number of the connection, > 0, never used again
    uid: int = -1
    holder: str = ""  # name of the client for others: "uid 1000, pid 4711"
    received: float | None = None  # s, when the whole call was in the front and next in turn; None: unknown


class SetMode(Command, frozen=True, kw_only=True):
    """Change where commands go. Reply: {mode}."""

    mode: str


class AcquireLease(Command, frozen=True, kw_only=True):
    """Take the lease; `take` takes it from another holder (motion holds first). Reply: {lease}."""

    take: bool = False


class RenewLease(Command, frozen=True, kw_only=True):
    """Keep the lease. Reply: {lease}."""


class ReleaseLease(Command, frozen=True, kw_only=True):
    """Give the lease back. Reply: {}."""


class Arm(Command, frozen=True, kw_only=True):
    """Goal := present, read back, then torque in `joints`; the others stay limp. None: in all joints.

    Reply when armed: {joints: [index]}.
    """

    joints: Sequence[int] | None = None
    edited: Sequence[str] = ()  # files of the robot that were changed since they were read


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

    `check_only`: reply {verdict}, nothing moves. Else with `more`: {phase, progress, verdict?, findings?,
    duration?, stretch?, stretched_by?} from `accepted` to one of succeeded, cancelled, replaced, aborted;
    without: one reply at `accepted`.
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
    front_checked: float = 0.0  # s, time of the state that the front judged its part from
    generation: int = 0  # of the limits that the front used
    refused: Sequence[
        Finding
    ] = ()  # findings of the front: clearance, torque, balance (SELF_COLLISION to UNSTABLE_POSE)
    warned: Sequence[Finding] = ()


class Cancel(Command, frozen=True, kw_only=True):
    """Decelerate and hold. Needs no lease. Reply: {state}."""


class Setpoint(Command, frozen=True, kw_only=True):
    """One streamed goal. Reply: {sequence, changes}, and {behind} (rad, by joint) where joints are late."""

    joints: Sequence[int]
    positions: Sequence[float]
    velocities: Sequence[float] | None = None
    valid_for: float = 0.1
    valid_until: float | None = None  # s; None: `valid_for` alone bounds it
    allow_clamp: bool = False

    def remaining(self, now: float) -> float:
        """Return how long it may be followed from `now` on, s."""
        return self.valid_for if self.valid_until is None else min(self.valid_until - now, self.valid_for)


class ReadRegister(Command, frozen=True, kw_only=True):
    """Read one register of one device. Reply: {register}."""

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
    """Restart one device; only while disarmed. Reply: {state, restored, differing}, RAM settings as text."""

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


class LocateJoints(Command, frozen=True, kw_only=True):
    """Choose the turns of joints that stand near these angles; only while calibrating. Reply: {positions}."""

    joints: Sequence[int]
    positions: Sequence[float]  # rad; of a joint of a transmission, that of its actuator


class Annotation(msgspec.Struct, frozen=True):
    """Annotation by a client of what the robot does, as `Annotation` of the interface."""

    kind: str  # begin, end, note
    task: str | None = None
    success: bool | None = None
    text: str | None = None


class Mark(Command, frozen=True, kw_only=True):
    """Report this as an event, for log and recordings. Reply: {sequence}, of an end {was_open} too."""

    annotation: Annotation


class ApplyChanges(Command, frozen=True, kw_only=True, tag="Adopt"):
    """Changes that loop and front make at one moment (`config/hot_changes.py`).

    The memfd holds the next front's briefing. Reply: {applied: [key], needs_restart: [key]}.
    """

    generation: int  # of that briefing: one more than the one in force
    changes: dict[str, Any]
    needs_restart: Sequence[str] = ()
    reread: bool = True  # from files read again; False: from a client's call
    on_trial: bool = False  # gains other than the file's are in force then, for this client alone


class ReloadStarted(LinkMessage, frozen=True, kw_only=True, tag="Rereading"):
    """Report that the front begins to read the files again."""


class ReloadFailed(LinkMessage, frozen=True, kw_only=True, tag="RereadFailed"):
    """Report what is wrong with the files; nothing changes."""

    message: str


class ConnectionClosed(LinkMessage, frozen=True, kw_only=True, tag="Gone"):
    """Report a closed connection: its lease lapses, its unanswered tickets are void."""

    client: int


class Rebound(LinkMessage, frozen=True, kw_only=True):
    """Report that a listening socket was bound again, as its file was gone. Its descriptor is attached."""

    name: str  # control or observe
    label: str  # of the `Listener`


class Reachable(LinkMessage, frozen=True, kw_only=True):
    """Report whether clients can connect: first message of a front, and one for every change."""

    missing: str = ""  # which socket cannot be reached, why, and the remedy; "": every socket is in place
    rebound: Sequence[str] = ()  # paths of the sockets that were bound again since the last message


class CrashRecordingDone(LinkMessage, frozen=True, kw_only=True, tag="WreckDone"):
    """Report that the flight recorder of a former daemon is written, or cannot be: it may be dropped."""


class Heartbeat(LinkMessage, frozen=True, kw_only=True):
    """Heartbeat of the front; at least twice a second."""


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
    | LocateJoints
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
