"""Positions of a robot in degrees, none of them stale."""

from math import degrees

from lerobot.utils.errors import DeviceNotConnectedError

from twind import Robot

STALE = 0.2  # s


def fresh_degrees(robot: Robot) -> dict[str, float]:
    """Return the positions by joint, degrees. Raises DeviceNotConnectedError: one is older than 0.2 s."""
    snapshot = robot.state
    stale = [name for name, fresh in zip(snapshot.names, snapshot.fresh(STALE), strict=True) if not fresh]
    if stale:
        raise DeviceNotConnectedError(
            f"{robot.name}: no reading of {', '.join(stale[:5])} for {STALE:g} s; `twindctl status` says why"
        )
    return {name: degrees(at) for name, at in zip(snapshot.names, snapshot.position.tolist(), strict=True)}
