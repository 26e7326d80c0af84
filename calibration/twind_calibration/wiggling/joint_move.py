"""Sending one joint away and home: through the daemon's gate, with the lease, and never left elsewhere."""

import argparse
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from twind.client import CallError, Client, Refused
from twind.client.errors import finding_text
from twind.command_line.verb import Rejected, UsageError, lease
from twind.ctl.hint_options import command_hint
from twind.protocol.messages import FindingMessage
from twind.robot.arrays import Floats
from twind.robot.finding import ReasonCode
from twind_drivers.clock import Clock

# s: on each way, and until it leaves again
OUT = 1.0
STAY = 0.6
# s: how long, and how often, the way home is asked for
PATIENCE = 10.0
AGAIN = 0.3
NEAR = 1e-3  # rad: closer than that its goal is home
# What the other direction may be free of.
ONE_SIDED = frozenset(
    {
        ReasonCode.POS_LIMIT,
        ReasonCode.BRAKE_DISTANCE,
        ReasonCode.SELF_COLLISION,
        ReasonCode.KEEP_OUT,
        ReasonCode.FLOOR,
    }
)


@dataclass(frozen=True, slots=True)
class MoveResult:
    """Result of a move. `refused`: why nothing moved; `ended`: what ended the move before its time."""

    way: float  # rad, away from home
    refused: tuple[str, ...] = ()
    ended: tuple[str, ...] = ()
    left: float = 0.0  # rad, distance of its last goal from home

    @property
    def moved(self) -> bool:
        """The daemon took the path."""
        return not self.refused


def path(joint: str, home: float, way: float) -> dict[str, object]:
    """Away, a stay, and home, each end at rest."""
    return tour(joint, ((home + way, OUT), (home, OUT)))


def tour(joint: str, legs: Sequence[tuple[float, float]]) -> dict[str, object]:
    """One place (rad) after the other, so many seconds on the way, at rest and with a stay at each."""
    points = []
    time = 0.0
    for place, seconds in legs:
        for after in (seconds, STAY):
            time += after
            points.append({"positions": [place], "velocities": [0.0], "time_from_start": time})
    return {"joint_names": [joint], "points": points[:-1]}


def direction(client: Client, joint: str, home: float, size: float) -> MoveResult:
    """Return the way that the gate permits: `size` (rad), else -`size`, else the reasons. Nothing moves."""
    ways = (size, -size)
    at, refused = allowed(client, [path(joint, home, way) for way in ways])
    return MoveResult(size if at is None else ways[at], refused)


def allowed(client: Client, ways: Sequence[dict[str, object]]) -> tuple[int | None, tuple[str, ...]]:
    """The first path that the gate lets go, else None and why not the first of all. Nothing moves."""
    first: tuple[str, ...] = ()
    for at, way in enumerate(ways):
        refusals = _judged(client, way)
        if not refusals:
            return at, ()
        first = first or tuple(finding_text(each) for each in refusals)
        if not {each["code"] for each in refusals} <= ONE_SIDED:
            break
    return None, first


def go(
    client: Client,
    clock: Clock,
    joint: str,
    home: float,
    way: float,
    *,
    take: bool,
    along: dict[str, Any] | None = None,
    tell: Callable[[str, float], None] = lambda _phase, _share: None,
) -> MoveResult:
    """Move a joint away and home, or along another path that goes no farther than `way`.

    A move that the daemon ended is brought home as soon as the gate permits. After a stop, or when another
    client took the lease, the joint stays where it is. `tell` receives each phase and the share done.
    """
    with lease(client, take=take):
        try:
            last: dict[str, Any] = {}
            for last in client.stream("SubmitTrajectory", trajectory=along or path(joint, home, way)):
                tell(last["phase"], last["progress"])
        except Refused as refusal:
            return MoveResult(way, refused=tuple(finding_text(each) for each in refusal.findings))
        if last["phase"] == "succeeded":
            return MoveResult(way)
        findings = last.get("findings") or ()
        ended = tuple(finding_text(each) for each in findings) or (str(last["phase"]),)
        taken = any(str(each["code"]).startswith("LEASE_") for each in findings)
        if last["phase"] != "aborted" or taken:  # a stop, or another client's motion: not ours to undo
            return MoveResult(way, ended=ended, left=_away(client, joint, home))
        return MoveResult(way, ended=ended, left=back(client, clock, joint, home, way))


def goal_of(client: Client, joint: str) -> float | None:
    """Return the goal of a joint, else its position (rad); None: unknown."""
    told = client.call("GetStatus", joints=True)
    [now] = [each for each in told["joints"] if each["name"] == joint]
    here = "position" if told["status"]["mode"] == "live" else "simulated"  # who is moved
    place: float | None = now[here] if now["goal"] is None else now["goal"]
    return place


def back(client: Client, clock: Clock, joint: str, home: float, way: float) -> float:
    """Bring a joint home from a move of `way` (rad) when the gate permits; return the rest, rad.

    The lease of that move is renewed, never acquired again: after its loss another client may use the robot.
    Nor is the joint brought from farther away than it went.
    """
    point = {"positions": [home], "velocities": [0.0], "time_from_start": OUT}
    homewards = {"joint_names": [joint], "points": [point]}
    away = 0.0
    until = clock.now() + PATIENCE
    while clock.now() < until:
        ours = _renewed(client)  # first: later readings then show no other client's motion
        away = _away(client, joint, home)
        if abs(away) <= NEAR:
            return 0.0
        status = client.call("GetStatus")["status"]
        if status["faults"] or (status["mode"] == "live" and not status["armed"]):
            return away  # a latched fault, or no torque: an operator is needed
        if not (ours and abs(away) <= abs(way) + NEAR):
            return away
        with suppress(CallError):  # refused: what ended the move is still there
            for _ in client.stream("SubmitTrajectory", trajectory=homewards):
                pass
        clock.sleep_until(clock.now() + AGAIN)
    return away


def _renewed(client: Client) -> bool:
    """Renew the lease; return whether this connection still has it."""
    try:
        client.call("RenewLease")
    except Refused:
        return False
    return True


def _away(client: Client, joint: str, home: float) -> float:
    """Return the distance of its goal from home, rad."""
    now = goal_of(client, joint)
    return 0.0 if now is None else now - home


def _judged(client: Client, trajectory: dict[str, object]) -> list[FindingMessage]:
    verdict = client.call("Check", trajectory=trajectory)["verdict"]
    refusals: list[FindingMessage] = [
        each for each in verdict["refusals"] if each["code"] != ReasonCode.LEASE_MISSING
    ]
    return refusals


AROUND = 0.4  # s that are recorded before and after a move
MOST_FRICTION = 100.0  # N·m


def require_amounts(options: argparse.Namespace, least: float, most: float) -> None:
    """Check the bounds of the motion (degrees) and of the friction (N·m). Raises UsageError."""
    if not least <= options.degrees <= most:
        raise UsageError(f"--degrees {options.degrees:g} is outside {least:g} to {most:g}")
    if not 0.0 <= options.friction <= MOST_FRICTION:
        raise UsageError(f"--friction {options.friction:g} is outside 0 to {MOST_FRICTION:g} N·m")


def require_armed(options: argparse.Namespace, client: Client) -> None:
    """Armed, by --arm if need be. Raises Rejected, ClientError."""
    if client.call("GetStatus")["status"]["armed"]:
        return
    if not options.arm:
        raise Rejected("the robot is not armed: `twindctl arm`, or --arm, when no person is in its way")
    with lease(client, take=options.take):
        client.call("Arm")


def pose(client: Client, names: Sequence[str]) -> Floats:
    """Return the positions of the joints (rad, (n,)); NaN: no reading yet."""
    joints = client.call("GetStatus", joints=True)["joints"]
    by_name = {each["name"]: each["position"] for each in joints}
    return np.array([by_name[name] for name in names], np.float64)


def seen(options: argparse.Namespace, name: str, looks: str) -> bool | None:
    """Ask the operator for the observed motion; None: no question, or no clear answer."""
    if options.no_ask or options.json or not sys.stdin.isatty():
        return None
    question = f"{name}: {looks}, and back: was it so" if looks else f"did {name} move, and no other joint"
    print(f"{question}? [y/n, else unknown] ", end="", file=sys.stderr, flush=True)
    return {"y": True, "yes": True, "n": False, "no": False}.get(sys.stdin.readline().strip().lower())


def print_note(options: argparse.Namespace, line: str) -> None:
    """To the person, beside the result; its commands reach the same daemon."""
    print(command_hint(options).prose(line), file=sys.stderr, flush=True)
