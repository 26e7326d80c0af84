"""Permission to command: whether this user may open control.sock. Standard library, Python 3.10."""

from __future__ import annotations

from collections.abc import Callable

from twind.client import CallError, Client, ClientError, NoDaemon

SOON = 2.0  # s for the answer


def denied(operator: Callable[[], Client]) -> str | None:
    """Return why such a connection cannot command; "": it can. None: no daemon answers."""
    try:
        with operator() as client:
            client.timeout = SOON
            client.call("ReleaseLease")  # it has none: the call only checks the role
    except NoDaemon as error:
        return None if error.absent else str(error)
    except CallError as error:
        return str(error) if error.name == "NotAllowed" else None
    except ClientError:
        return None
    return ""
