"""Joints without torque, which may be moved by hand: no other client gives them torque meanwhile.

The lease of this connection keeps the daemon in the state calibrating, where it refuses arming and another
mode. In mirror too: another client could otherwise select `live` and arm while hands are on the robot.
Standard library only.
"""

import contextlib
from collections.abc import Callable, Collection, Iterator

from twind.client import Client
from twind.command_line.verb import Rejected, calibrating, lease
from twind_drivers.clock import Clock

RENEW = 0.3  # s; a lease lasts one
PATIENCE = 5.0  # s that torque may take to be read after a connect
PAUSE = 0.1  # s between two questions


@contextlib.contextmanager
def limp(
    client: Client, clock: Clock, *, take: bool, joints: Collection[str] | None = None
) -> Iterator[Callable[[], None]]:
    """Keep torque off `joints` (None: all); call the yielded function at every reading, it renews the lease.

    Raises Rejected (mode sim, a joint with torque or with unknown torque), ClientError.
    """
    armed = require_limp(client, clock, joints)
    with (lease if armed else calibrating)(client, take=take):
        _require_off(client, clock, joints)  # another client may have armed meanwhile
        yield _renewing(client, clock)


def require_limp(client: Client, clock: Clock, joints: Collection[str] | None = None) -> bool:
    """Check that torque is off now; call it before a question to the operator. Raises as `limp`.

    Returns whether the robot is armed: then `joints` are limp and others hold.
    """
    if client.call("GetStatus")["status"]["mode"] == "sim":
        raise Rejected("mode sim reads no robot: `twindctl mode mirror`")
    return _require_off(client, clock, joints)


def _renewing(client: Client, clock: Clock) -> Callable[[], None]:
    """Return a function that renews the lease when it is due."""
    renewed = clock.now()

    def keep() -> None:
        nonlocal renewed
        if clock.now() - renewed > RENEW:
            client.call("RenewLease")
            renewed = clock.now()

    return keep


def _require_off(client: Client, clock: Clock, joints: Collection[str] | None) -> bool:
    """Return whether the robot is armed. Raises Rejected: a joint's torque is on or unknown."""
    deadline = clock.now() + PATIENCE
    while True:
        answer = client.call("GetStatus", joints=True)
        armed = bool(answer["status"]["armed"])
        chosen = [joint for joint in answer["joints"] if joints is None or joint["name"] in joints]
        on = [joint["name"] for joint in chosen if joint["torque"]]
        if on or (armed and joints is None):
            who = ", ".join(on) or "the robot"
            raise Rejected(f"torque is on: {who}. `twindctl disarm` lowers it and takes it off; then again")
        unknown = [each["name"] for each in chosen if each["heard"] and each["torque"] is None]
        if not unknown:
            return armed
        if clock.now() > deadline:
            raise Rejected(f"torque is unknown: {', '.join(unknown)}: see `twindctl status --joints`")
        clock.sleep_until(clock.now() + PAUSE)
