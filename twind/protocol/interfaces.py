"""The interfaces the daemon speaks, as they stand in the package's IDL files."""

from importlib.resources import files

from twind.protocol.idl import Interface, parse

CONTROL = "io.twind.Control"
SERVICE = "org.varlink.service"


def load(name: str) -> Interface:
    """`CONTROL` or `SERVICE`, parsed. Raises FileNotFoundError for another name."""
    return parse((files("twind.protocol") / f"{name}.varlink").read_text("utf-8"))
