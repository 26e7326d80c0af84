"""What may be asked for as an episode begins: the options of a `reset`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from twind.learn.observation_layout import COMMAND

Command = tuple[float, float, float]
MOST = 5.0  # m/s, m/s, rad/s: what an observation can say of a command


def command_in(options: Mapping[str, Any] | None, *others: str) -> Command | None:
    """The command in them, None: a drawn one. `others`: what else may stand there.

    Raises ValueError: another option, or no command.
    """
    given = options or {}
    known = ("command", *others)
    for name in given:
        if name not in known:
            raise ValueError(f"option {name!r}: {' or '.join(known)}")
    return None if given.get("command") is None else command_of(given["command"])


def command_of(given: Sequence[float]) -> Command:
    """Forward, left (m/s), turn (rad/s). Raises ValueError: it is not that."""
    try:
        command = np.array(given, np.float64)
    except (TypeError, ValueError):
        command = np.zeros(0)
    if command.shape != (COMMAND,) or not (np.abs(command) <= MOST).all():
        raise ValueError(
            f"command {given!r}: three numbers are needed, m/s forward, m/s left and rad/s of turning, "
            f"each within ±{MOST:g}"
        )
    forward, left, turn = command.tolist()
    return forward, left, turn
