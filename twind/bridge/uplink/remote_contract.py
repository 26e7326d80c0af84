"""Contract of remote queries over Zenoh: their check, as at the control socket, and their refusal. Pure."""

from __future__ import annotations

from typing import Any

import msgspec

from twind.client.errors import CallError, ClientError, as_error
from twind.exceptions import InvalidInput
from twind.protocol import CONTROL, SERVICE, load, parse
from twind.protocol.strict_json import loads

UPLINK = "io.twind.Uplink"
MOST = 4 << 20  # bytes of a trajectory's question, as the daemon's
SMALL = 64 << 10  # of any other
HOLDER = 80  # characters of a holder's name that are kept
CARRIERS = frozenset({"Check", "Goal"})  # of trajectories

INTERFACE = parse("""
interface io.twind.Uplink

# op: acquire (holder: text for display), renew and release (lease: as granted).
# take: from a remote holder, until deadline (as a goal's), so that no waiting request takes it later.
# now: the robot's clock, s. Without a renewal it lapses after expires_in s, and the motion ends.
method Lease(
  op: (acquire, renew, release),
  holder: ?string,
  take: ?bool,
  deadline: ?float,
  lease: ?string
) -> (
  lease: string,
  holder: string,
  expires_in: float,
  now: float
)

# goal: a name, used once. deadline: until when it may be accepted, s of the robot's clock, <= 60 s ahead.
# A repeated query with the same goal and lease returns its present state and moves nothing; likewise a
# query without deadline and trajectory.
method Goal(goal: string, lease: string, deadline: ?float, trajectory: ?object) -> (
  id: string,
  phase: string,
  progress: float,
  verdict: ?object,
  findings: ?[]object
)

# As the daemon's; what is neither level is refused here already.
method EStop(level: ?(settle, cut), reason: ?string) -> (state: string, torque_off: ?bool, done: bool)

# The uplink reaches no daemon, or has no permission.
error NoDaemon (message: string)
""")
_METHODS = load(CONTROL).methods | INTERFACE.methods


class LeaseQuery(msgspec.Struct, frozen=True):
    """Parameters of `Lease`. `deadline`: s of the robot's clock."""

    op: str
    holder: str = ""
    take: bool = False
    deadline: float | None = None
    lease: str = ""


class GoalQuery(msgspec.Struct, frozen=True):
    """Parameters of `Goal`. `deadline`: s of the robot's clock."""

    goal: str
    lease: str
    deadline: float | None = None
    trajectory: dict[str, object] | None = None


def check_query(method: str, data: bytes) -> dict[str, Any]:
    """Return the checked parameters of `method`, of CONTROL or the uplink. Raises CallError: invalid."""
    check_size(method, len(data))
    try:
        parameters: dict[str, Any] = loads(data) if data else {}
        _METHODS[method].parameters.check(parameters, "")
    except InvalidInput as error:
        raise invalid(error.where or "parameters", error.reason) from None
    parameters = {key: value for key, value in parameters.items() if value is not None}
    if "holder" in parameters:
        parameters["holder"] = parameters["holder"][:HOLDER]
    return parameters


def check_size(method: str, size: int) -> None:
    """Raise CallError if a query of `method` may not have `size` bytes."""
    bound = MOST if method in CARRIERS else SMALL
    if size > bound:
        raise invalid("parameters", f"{size} bytes, bound {bound}")


def invalid(parameter: str, message: str) -> CallError:
    """Return the error for an invalid parameter."""
    return as_error(f"{SERVICE}.InvalidParameter", {"parameter": parameter, "message": message})


def busy(what: str) -> CallError:
    """Return the refusal for too many queries at once."""
    return as_error(f"{CONTROL}.Busy", {"what": what})


def as_call_error(error: ClientError) -> CallError:
    """Return the error as remote clients get it: NoDaemon for one that is away, silent, or refuses."""
    return error if isinstance(error, CallError) else as_error(f"{UPLINK}.NoDaemon", {"message": str(error)})
