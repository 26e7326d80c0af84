"""Which modules are mutated and must be covered whole, and the tests that must notice: those of the room."""

from dataclasses import dataclass
from pathlib import Path

HOME = Path(__file__).parents[2]
DRIVER = "drivers/twind_drivers/dynamixel"


@dataclass(frozen=True, slots=True)
class Room:
    """Modules that are tested together. Paths from the repository's root."""

    name: str
    modules: tuple[str, ...]
    tests: tuple[str, ...]


def _room(name: str, folder: str, modules: str, tests: str) -> Room:
    return Room(
        name,
        tuple(f"{folder}/{each}.py" for each in modules.split()),
        tuple(f"tests/test_{each}.py" for each in tests.split()),
    )


ROOMS = (
    _room("states", "twind/safety", "states", "states"),
    _room("lease", "twind/safety", "lease", "lease"),
    _room("latency", "twind/safety", "alarm way", "alarm way"),
    _room(
        "codec",
        DRIVER,
        "packet crc goals",
        "dynamixel_packet dynamixel_framer dynamixel_crc dynamixel_goals",
    ),
    _room(
        "gate",
        "twind/safety",
        "gate rules bounds form retime stream headroom",
        "gate gate_told gate_edges form_edges rules bounds form retime safety_stream headroom",
    ),
    _room(
        "guard",
        "twind/safety",
        "guard facts goal_rules reading_rules bus_rules device_rules senses"
        " heat_rules line_rules outlook_rules power_rules stall_rules tracking_rules",
        "guard guard_telling goal_rules bus_rules device_rules senses"
        " heat_rules line_rules outlook_rules power_rules stall_rules tracking_rules support_rules",
    ),
    _room("homing", "twind/motion", "homing", "homing homing_edges homing_ends"),
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
