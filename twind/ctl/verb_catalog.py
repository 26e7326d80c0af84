"""Verbs of `twindctl`: built in, and of installed packages by the entry points `twind.verbs`."""

from collections.abc import Iterable
from importlib import import_module
from typing import Any

from twind.command_line.verb import GROUPS, Verb, help_text

# name -> module, and the object in it where the module itself is not the verb
BUILT_IN = {
    "status": "twind.ctl.status_table:STATUS",
    "monitor": "twind.ctl.monitor_command:MONITOR",
    "watch": "twind.ctl.monitor_command:WATCH",
    "mode": "twind.ctl.single_call_commands:MODE",
    "arm": "twind.ctl.single_call_commands:ARM",
    "disarm": "twind.ctl.single_call_commands:DISARM",
    "move": "twind.ctl.motion_commands:MOVE",
    "play": "twind.ctl.motion_commands:PLAY",
    "teach": "twind.ctl.teach_command",
    "follow": "twind.ctl.follow_command",
    "teleop": "twind.ctl.teleop_command",
    "walk": "twind.ctl.walk_command",
    "stop": "twind.ctl.single_call_commands:STOP",
    "estop": "twind.ctl.estop:ESTOP",
    "reset": "twind.ctl.single_call_commands:RESET",
    "mark": "twind.ctl.single_call_commands:MARK",
    "dump": "twind.ctl.single_call_commands:DUMP",
    "reload": "twind.ctl.reload_commands:RELOAD",
    "parameters": "twind.ctl.reload_commands:PARAMETERS",
    "check": "twind.ctl.check_command",
    "register": "twind.ctl.single_call_commands:REGISTER",
    "reboot": "twind.ctl.single_call_commands:REBOOT",
    "demo": "twind.ctl.demo",
}
ENTRY_POINTS = "twind.verbs"
OTHER = "other"  # heading of installed verbs without a group of GROUPS


def find_verb(name: str) -> Verb | None:
    """The verb of that name, imported. None: no such verb."""
    if name in BUILT_IN:
        module, _, attribute = BUILT_IN[name].partition(":")
        found: Any = import_module(module)
        verb: Verb = getattr(found, attribute) if attribute else found
        return verb
    point = _entry_points().get(name)
    loaded: Verb | None = None if point is None else point.load()
    return loaded


def verb_names() -> list[str]:
    """Names of all verbs, the built-in ones first."""
    return [*BUILT_IN, *(name for name in _entry_points() if name not in BUILT_IN)]


def grouped_verbs() -> dict[str, dict[str, Verb]]:
    """All verbs, imported: by heading of the help, then by name."""
    groups: dict[str, dict[str, Verb]] = {group: {} for group in (*GROUPS, OTHER)}
    for name in verb_names():
        verb = find_verb(name)
        if verb is not None:
            group = getattr(verb, "group", OTHER)
            groups[group if group in GROUPS else OTHER][name] = verb
    return {group: verbs for group, verbs in groups.items() if verbs}


def summary(verb: Verb) -> str:
    """The line of the verb in `twindctl --help`."""
    return help_text(verb).partition("\n")[0]


def _entry_points() -> dict[str, Any]:
    from importlib.metadata import entry_points  # takes 20 ms, which `status` need not pay

    found: Iterable[Any] = entry_points(group=ENTRY_POINTS)
    return {point.name: point for point in found}
