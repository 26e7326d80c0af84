"""A robot whose joints a person may move: nobody has torque, and nobody gives it while they do.

The daemon is kept in the state calibrating by the lease of this connection: nobody arms, and the mode stays.
In mirror too, or somebody else would say `mode live` and arm while hands are on the robot.
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
    """Torque is off and stays off; what is given keeps it so when called now and then.

    Raises Rejected (mode sim, a joint with torque or of which nobody knows), ClientError.
    """
    require_limp(client, clock)
    with calibrating(client, take=take):
        _require_off(client, clock)  # nobody armed meanwhile
        yield _renewing(client, clock)


def require_limp(client: Client, clock: Clock) -> None:
    """Torque is off now. Whoever asks a person first asks this before. Raises as `limp`."""
    if client.call("GetStatus")["status"]["mode"] == "sim":
        raise Rejected("mode sim reads no robot: `twindctl mode mirror`")
    _require_off(client, clock)


def _renewing(client: Client, clock: Clock) -> Callable[[], None]:
    """Renews the lease when it is time."""
    renewed = clock.now()

    def keep() -> None:
        nonlocal renewed
        if clock.now() - renewed > RENEW:
            client.call("RenewLease")
            renewed = clock.now()

    return keep


def _require_off(client: Client, clock: Clock) -> None:
    """Raises Rejected: somebody's torque is on, or nobody knows of it."""
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
            raise Rejected(
                f"nobody knows whether torque is off: {', '.join(unknown)}: `twindctl status --joints`"
            )
        clock.sleep_until(clock.now() + PAUSE)
