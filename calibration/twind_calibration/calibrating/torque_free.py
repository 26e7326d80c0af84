"""Robot without torque, whose joints may be moved by hand: arming is refused meanwhile.

The lease of this connection keeps the daemon in the state calibrating, where it refuses arming and another
mode. In mirror too: another client could otherwise select `live` and arm while hands are on the robot.
"""

import contextlib
from collections.abc import Callable, Iterator

from twind.client import Client
from twind.command_line.verb import Rejected, calibrating
from twind_drivers.clock import Clock

RENEW = 0.3  # s; a lease lasts one
PATIENCE = 5.0  # s that torque may take to be read after a connect
PAUSE = 0.1  # s between two questions


@contextlib.contextmanager
def limp(client: Client, clock: Clock, *, take: bool) -> Iterator[Callable[[], None]]:
    """Keep torque off; call the yielded function at every reading, it renews the lease.

    Raises Rejected (mode sim, a joint with torque or with unknown torque), ClientError.
    """
    require_limp(client, clock)
    with calibrating(client, take=take):
        _require_off(client, clock)  # another client may have armed meanwhile
        yield _renewing(client, clock)


def require_limp(client: Client, clock: Clock) -> None:
    """Check that torque is off now; call it before a question to the operator. Raises as `limp`."""
    if client.call("GetStatus")["status"]["mode"] == "sim":
        raise Rejected("mode sim reads no robot: `twindctl mode mirror`")
    _require_off(client, clock)


def _renewing(client: Client, clock: Clock) -> Callable[[], None]:
    """Return a function that renews the lease when it is due."""
    renewed = clock.now()

    def keep() -> None:
        nonlocal renewed
        if clock.now() - renewed > RENEW:
            client.call("RenewLease")
            renewed = clock.now()

    return keep


def _require_off(client: Client, clock: Clock) -> None:
    """Raises Rejected: a joint's torque is on or unknown."""
    deadline = clock.now() + PATIENCE
    while True:
        answer = client.call("GetStatus", joints=True)
        on = [joint["name"] for joint in answer["joints"] if joint["torque"]]
        if answer["status"]["armed"] or on:
            who = ", ".join(on) or "the robot"
            raise Rejected(f"torque is on: {who}. `twindctl disarm` lowers it and takes it off; then again")
        unknown = [each["name"] for each in answer["joints"] if each["heard"] and each["torque"] is None]
        if not unknown:
            return
        if clock.now() > deadline:
            raise Rejected(f"torque is unknown: {', '.join(unknown)}: see `twindctl status --joints`")
        clock.sleep_until(clock.now() + PAUSE)
