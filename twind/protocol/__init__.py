"""Control interface: its IDL text, the checks of calls, and strict JSON. Standard library only."""

from twind.exceptions import InvalidInput
from twind.protocol.idl import IdlInterface, parse
from twind.protocol.interfaces import CONTROL, SERVICE, load

__all__ = ["CONTROL", "SERVICE", "IdlInterface", "InvalidInput", "load", "parse"]
