"""Answers of an uplink as received: JSON of the interface, before the client decodes it."""

import json


def error_name(message: bytes) -> str | None:
    """The error that a message carries, without its interface. "": none; None: this is no message."""
    try:
        error = json.loads(message).get("error")
    except (ValueError, RecursionError, AttributeError):
        return None
    return "" if error is None else str(error).rpartition(".")[2]
