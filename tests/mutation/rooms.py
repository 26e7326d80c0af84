"""Which modules are mutated and must be covered whole, and the tests that must notice: those of the room."""

from dataclasses import dataclass
from pathlib import Path

HOME = Path(__file__).parents[2]


@dataclass(frozen=True, slots=True)
class Room:
    """Modules that are tested together. Paths from the repository's root."""

    name: str
    modules: tuple[str, ...]
    tests: tuple[str, ...]


ROOMS = (
    Room(
        "states",
        ("twind/safety/state_machine.py",),
        ("tests/test_states.py",),
    ),
    Room(
        "lease",
        ("twind/safety/lease.py",),
        ("tests/test_lease.py",),
    ),
    Room(
        "latency",
        (
            "twind/safety/latency_alarm.py",
            "twind/telemetry/command_latency.py",
        ),
        (
            "tests/test_alarm.py",
            "tests/test_way.py",
        ),
    ),
    Room(
        "codec",
        (
            "drivers/twind_drivers/dynamixel/packet.py",
            "drivers/twind_drivers/dynamixel/crc.py",
            "drivers/twind_drivers/dynamixel/goal_packets.py",
        ),
        (
            "tests/test_dynamixel_packet.py",
            "tests/test_dynamixel_framer.py",
            "tests/test_dynamixel_crc.py",
            "tests/test_dynamixel_goals.py",
        ),
    ),
    Room(
        "gate",
        (
            "twind/safety/gate.py",
            "twind/safety/curve_rules.py",
            "twind/safety/polynomial_bounds.py",
            "twind/safety/trajectory_validation.py",
            "twind/safety/retime.py",
            "twind/safety/setpoint_gate.py",
            "twind/safety/headroom.py",
        ),
        (
            "tests/test_gate.py",
            "tests/test_gate_told.py",
            "tests/test_gate_edges.py",
            "tests/test_form_edges.py",
            "tests/test_rules.py",
            "tests/test_bounds.py",
            "tests/test_form.py",
            "tests/test_retime.py",
            "tests/test_safety_stream.py",
            "tests/test_headroom.py",
        ),
    ),
    Room(
        "guard",
        (
            "twind/safety/guard.py",
            "twind/safety/guard_types.py",
            "twind/safety/goal_rules.py",
            "twind/safety/reading_rules.py",
            "twind/safety/bus_rules.py",
            "twind/safety/device_rules.py",
            "twind/safety/plausibility_filter.py",
            "twind/safety/heat_rules.py",
            "twind/safety/can_line_rules.py",
            "twind/safety/clearance_rules.py",
            "twind/safety/power_rules.py",
            "twind/safety/stall_rules.py",
            "twind/safety/tracking_rules.py",
        ),
        (
            "tests/test_guard.py",
            "tests/test_guard_telling.py",
            "tests/test_goal_rules.py",
            "tests/test_bus_rules.py",
            "tests/test_device_rules.py",
            "tests/test_senses.py",
            "tests/test_heat_rules.py",
            "tests/test_line_rules.py",
            "tests/test_outlook_rules.py",
            "tests/test_power_rules.py",
            "tests/test_stall_rules.py",
            "tests/test_tracking_rules.py",
            "tests/test_support_rules.py",
        ),
    ),
    Room(
        "homing",
        ("twind/motion/endstop_search.py",),
        (
            "tests/test_homing.py",
            "tests/test_homing_edges.py",
            "tests/test_homing_ends.py",
        ),
    ),
)


def importable(module: str) -> str:
    """The dotted name of a module's path."""
    return module.removeprefix("drivers/").removesuffix(".py").replace("/", ".")


def rooms_of(names: list[str]) -> list[tuple[Room, tuple[str, ...]]]:
    """Rooms with the modules chosen by name of room, path or end of a path; all where none is given."""
    chosen = []
    for room in ROOMS:
        modules = tuple(
            module
            for module in room.modules
            if not names or room.name in names or any(module.endswith(name) for name in names)
        )
        chosen += [(room, modules)] if modules else []
    known = {room.name for room in ROOMS} | {module for room in ROOMS for module in room.modules}
    for name in names:
        if not any(each.endswith(name) for each in known):
            raise SystemExit(f"no room or module {name!r}; rooms: {', '.join(room.name for room in ROOMS)}")
    return chosen
