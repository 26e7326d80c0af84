"""Control interface: its IDL text, the checks of calls, and strict JSON. Standard library only."""

from twind.exceptions import InvalidInput
from twind.protocol.idl import IdlInterface, parse

__all__ = ["CONTROL", "SERVICE", "IdlInterface", "InvalidInput", "load", "parse"]


CONTROL = "io.twind.Control"
SERVICE = "org.varlink.service"


def load(name: str) -> IdlInterface:
    """Parse `CONTROL` or `SERVICE`. Raises FileNotFoundError for another name."""
    # Imported here: it brings tempfile, shutil and urllib along, a quarter of the time of `twindctl status`.
    from importlib.resources import files  # noqa: PLC0415

    return parse((files("twind.protocol") / f"{name}.varlink").read_text("utf-8"))
