"""Blanks every text for people that a daemon sends: events, findings, errors, statuses, warnings.

`pytest --blank-messages` loads it (tests/conftest.py). `hook` reaches modules that are imported already and
those still to come; `sitecustomize.py` does the same in every process that the tests start. Codes, ids and
numbers stay as they are.
"""

import functools
import importlib.abc
import importlib.util
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

BLANK = "x"
TEXTS = frozenset({"message", "what", "state"})  # parameters of errors whose words are for people

Patch = Callable[[Any], None]


def blank(text: str) -> str:
    """The text that takes the place of `text`; an empty one says that there is nothing to report."""
    return BLANK if text else text


def _finding(module: Any) -> None:
    made = module.Finding.__init__

    @functools.wraps(made)
    def init(self: Any, *args: Any, **fields: Any) -> None:
        made(self, *args, **fields)
        object.__setattr__(self, "message", blank(self.message))

    module.Finding.__init__ = init


def _responder(module: Any) -> None:
    event = module.Responder.event
    error = module.Responder.error
    mark = module.Responder.mark

    def blank_event(self: Any, level: str, code: str, message: str, *args: Any, **fields: Any) -> None:
        event(self, level, code, blank(message), *args, **fields)

    def blank_error(self: Any, command: Any, name: str, /, **parameters: Any) -> None:
        error(self, command, name, **_blanked(parameters))

    def blank_mark(self: Any, command: Any, code: str, message: str) -> None:
        mark(self, command, code, blank(message))

    module.Responder.event = blank_event
    module.Responder.error = blank_error
    module.Responder.mark = blank_mark


def _naming(module: Any) -> None:
    module.describe_finding = lambda *_args: BLANK


def _calls(module: Any) -> None:
    error = module.ClientCall.error

    def blank_error(self: Any, name: str, parameters: Mapping[str, Any], *args: Any) -> None:
        error(self, name, _blanked(parameters), *args)

    module.ClientCall.error = blank_error


def _realtime(module: Any) -> None:
    made = module.Granted.__init__

    def init(self: Any, text: str, granted: bool = True) -> None:
        made(self, blank(text), granted)

    module.Granted.__init__ = init


def _ports(module: Any) -> None:
    warning = module.BusPort.warning.fget
    module.BusPort.warning = property(lambda self: blank(warning(self)))


def _bus(module: Any) -> None:
    module.BusError.__str__ = lambda self: BLANK


def _blanked(parameters: Mapping[str, Any]) -> dict[str, Any]:
    return {
        key: blank(value) if key in TEXTS and isinstance(value, str) else value
        for key, value in parameters.items()
    }


PATCHES: dict[str, Patch] = {
    "twind.robot.finding": _finding,
    "twind.loop.ipc.responder": _responder,
    "twind.loop.process.realtime": _realtime,
    "twind.loop.bus.bus_port": _ports,
    "twind.front.joint_naming": _naming,
    "twind.front.client_calls": _calls,
    "twind_drivers.bus": _bus,
}


class _Patched(importlib.abc.Loader):
    """Loads a module as its own loader does, then patches it."""

    def __init__(self, inside: importlib.abc.Loader, patch: Patch) -> None:
        self._inside = inside
        self._patch = patch

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._inside.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        self._inside.exec_module(module)
        self._patch(module)


class _Hook(importlib.abc.MetaPathFinder):
    """Finds the modules of PATCHES where the other finders find them."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if name not in PATCHES:
            return None
        for finder in sys.meta_path:
            spec = None if finder is self else finder.find_spec(name, path, target)
            if spec is not None and spec.loader is not None:
                spec.loader = _Patched(spec.loader, PATCHES[name])
                return spec
        return None


def hook() -> None:
    """Blank the texts of this process from now on."""
    if not any(isinstance(finder, _Hook) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Hook())
        for name, patch in PATCHES.items():
            if name in sys.modules:
                patch(sys.modules[name])
