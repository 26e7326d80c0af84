"""Where the joints of a goal are to be and are, while it runs. Standard library, 3.10."""

from __future__ import annotations

import argparse
import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from typing import Any

from twind.client import ClientError
from twind.ctl.verb import observer

RATE = 20.0  # Hz: `action_monitor_rate` of the usual controller
PATIENCE = 1.0  # s for a word of the daemon

State = Mapping[str, Any]  # an answer of Monitor, topic `state`


def states(sockets: str | None) -> Generator[State | None, None, None]:
    """States at RATE, without end, on a connection of its own; None about as often where there are none."""
    while True:
        try:
            with closing(observer(argparse.Namespace(socket=sockets))) as client:
                client.timeout = PATIENCE
                yield from client.stream("Monitor", topics=["state"], rate=RATE)
        except ClientError:
            time.sleep(1.0 / RATE)
            yield None


def places(state: State, names: Sequence[str]) -> tuple[list[float], list[float], list[float]] | None:
    """Desired, actual and their difference in rad, of these joints; None: one of them is not known."""
    joints = {joint["name"]: joint for joint in state["joints"]}
    moved = "position" if state.get("mode") == "live" else "simulated"
    rows = [(joints.get(name, {}).get("goal"), joints.get(name, {}).get(moved)) for name in names]
    known = [(float(goal), float(place)) for goal, place in rows if goal is not None and place is not None]
    if len(known) < len(names):
        return None
    return [goal for goal, _ in known], [place for _, place in known], [goal - place for goal, place in known]
