"""Record of a driver family, and the finder of the installed ones.

A family is all that twind knows of one kind of bus: the devices on it, their keys in a robot file, their
reader and writer, their checks, their virtual twin. A package registers its record as an entry point of the
group `twind.drivers`, named as the kind of its buses:

    [project.entry-points."twind.drivers"]
    feetech = "twind_drivers.feetech.feetech_family:FEETECH"

No other module names a family. Those of configuration and loop ask the record, and the `TypeSpec` that the
record makes of an entry of `types`. What only one program needs is a `FamilyPart`, imported at first use: the
loop loads neither the doctor's rows nor virtual devices.
"""

from argparse import Namespace
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from types import MappingProxyType
from typing import Any, Generic, Protocol, TypeVar

from twind.config.actuator_types import TypeSpec
from twind.config.config_reader import ConfigReader
from twind.config.family_keys import BusKeys, SlotKeys, TypeKeys
from twind.config.port_names import Medium
from twind.config.robot_spec import ActuatorSlot, BusSpec, ImuSpec, JointSpec
from twind.exceptions import InvalidInput
from twind_drivers.bus import BusReader, Ints
from twind_drivers.bus_writer import BusWriter

ENTRY_POINTS = "twind.drivers"

P = TypeVar("P")


@dataclass(frozen=True, slots=True)
class FamilyPart(Generic[P]):
    """Part of a family that is imported at first use. `place`: `module:attribute`."""

    place: str

    def load(self) -> P:
        """Import and return the part."""
        module, _, attribute = self.place.partition(":")
        part: P = getattr(import_module(module), attribute)
        return part


@dataclass(frozen=True, slots=True)
class SlotEntry:
    """Entry of an actuator, or of a joint with its own, as `DriverFamily.read_slot` receives it."""

    name: str
    bus: str
    section: ConfigReader
    type_section: ConfigReader  # entry of its type, for errors whose remedy stands there
    beside: tuple[type, ...]  # further shapes of the entry, whose keys are known too


@dataclass(frozen=True, slots=True)
class BusSetup:
    """One bus of a robot as its driver needs it. `joints` and arrays (m,) are in the order of `ids`."""

    bus: BusSpec
    ids: tuple[int, ...]
    joints: tuple[JointSpec, ...]
    lower: Ints  # counts: the goals that may leave (WIRE_CLAMP)
    upper: Ints
    rate_hz: float
    sensors: Mapping[int, float]  # id -> reply delay (s) of further devices on the bus


@dataclass(frozen=True, slots=True)
class BusDriver:
    """Makers of the two halves of a bus."""

    reader: Callable[[BusSetup, Any], BusReader]  # of an open port of the family's medium
    writer: Callable[[BusSetup, BusReader], BusWriter]  # of a reader that `reader` made


class CycleBudget(Protocol):
    """Time of one bus at one rate."""

    @property
    def bus(self) -> BusSpec:
        """The bus, as described in the robot file."""

    @property
    def refusal(self) -> str | None:
        """Why the rate is out of reach; None: it is within reach."""

    @property
    def lines(self) -> tuple[str, ...]:
        """The arithmetic as text lines."""


@dataclass(frozen=True, slots=True)
class BudgetRequest:
    """One bus with its joints, at least one, and the rate that is wanted."""

    bus: BusSpec
    joints: Sequence[JointSpec]
    rate_hz: float
    imu: ImuSpec | None  # on this bus


def no_clash(slot: ActuatorSlot, others: Sequence[ActuatorSlot], section: ConfigReader) -> None:
    """Refuse nothing: devices of the family are told apart by their ids alone."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DriverFamily:
    """One kind of bus with its devices. A capability is here only if families differ in it and code asks."""

    kind: str  # of its buses in a robot file; also the name of the entry point
    medium: Medium  # its ports: serial (`ByteTransport`), or CAN (`CanChannel`)

    # Robot file. Errors are ConfigErrors that name file, key, value and bound.
    bus_keys: type[BusKeys]  # entry of `buses`
    type_keys: type[TypeKeys]  # entry of `types`
    slot_keys: type[SlotKeys]  # of an actuator, or of a joint with its own
    read_bus: Callable[[str, ConfigReader], BusSpec]
    knows: Callable[[str], bool]  # this `device` of a type is a model of the family
    models: Callable[[], Collection[str]]  # names of all models, to suggest one
    read_type: Callable[[str, ConfigReader], TypeSpec]
    read_slot: Callable[[SlotEntry, TypeSpec], ActuatorSlot]
    budget: Callable[[BudgetRequest], CycleBudget]
    # Refuses, beyond equal ids, a slot that shares frames with one of those before it.
    refuse_clash: Callable[[ActuatorSlot, Sequence[ActuatorSlot], ConfigReader], None] = no_clash

    # Bus
    driver: FamilyPart[BusDriver]
    virtual: FamilyPart[Any]  # a `twind.virtual.virtual_twin.VirtualTwin`
    doctor: FamilyPart[Any] | None = None  # a `twind.doctor.family_doctor.FamilyDoctor`
    # Of `twindctl scan --port`, `adopt` and `robot servo`: the verb's options in, its exit code out.
    scan: FamilyPart[Callable[[Namespace], int]] | None = None
    adopt: FamilyPart[Callable[[Namespace], int]] | None = None
    relocate: FamilyPart[Callable[[Namespace], int]] | None = None
    # A `twind_drivers.servo_tools.family_tools.FamilyTools`, of serial servos, for scan, adoption, doctor.
    tools: FamilyPart[Any] | None = None
    takes_imu: bool = False  # an IMU with the family's protocol may be on its bus
    # Register that explains the alert bit of a reply, read at once; empty: no reply has such a bit.
    alert_register: str = ""


@cache
def registered() -> Mapping[str, EntryPoint]:
    """Entry points by kind. Raises InvalidInput: two packages register one kind."""
    found: dict[str, EntryPoint] = {}
    for point in sorted(entry_points(group=ENTRY_POINTS), key=lambda each: each.name):
        if found.setdefault(point.name, point).value != point.value:
            both = f"{found[point.name].value} and {point.value}"
            raise InvalidInput(f"two installed packages drive buses of kind {point.name}: {both}")
    return MappingProxyType(found)


def kinds() -> tuple[str, ...]:
    """Kinds of bus that this installation can drive; no family is imported for it."""
    return tuple(registered())


@cache
def family(kind: str) -> DriverFamily:
    """Return the family of a kind of bus, imported. Raises InvalidInput: none, or an unusable one."""
    point = registered().get(kind)
    if point is None:
        raise InvalidInput(
            f"no installed package drives buses of kind {kind!r}; installed: {', '.join(kinds()) or 'none'}"
        )
    try:
        found: DriverFamily = point.load()
    except (ImportError, AttributeError) as error:
        raise InvalidInput(f"driver family {kind}: {point.value} cannot be imported: {error}") from error
    if found.kind != kind:
        raise InvalidInput(f"{point.value} is registered for kind {kind}, but drives {found.kind}")
    return found


def families() -> tuple[DriverFamily, ...]:
    """Return all installed families, imported."""
    return tuple(family(kind) for kind in kinds())


def family_of(device: str, here: Sequence[DriverFamily] = ()) -> DriverFamily:
    """Return the family that knows a device; else the one with the nearest name, whose parser will refuse it.

    `here`: families to ask first, such as those of a file's buses.
    """
    for each in here:
        if each.knows(device):
            return each
    others = families()
    known = [each for each in others if each.knows(device)]
    return known[0] if known else max((*here, *others), key=lambda each: _similarity(device, each))


def unknown_model(device: str) -> str:
    """Return the refusal of a misspelt device, with three models of all families that begin most like it."""
    wanted = device.upper()

    def difference(name: str) -> float:
        return 1.0 - SequenceMatcher(None, wanted, name[: len(wanted)].upper()).ratio()

    models = dict.fromkeys(name for each in families() for name in sorted(each.models()))
    near = ", ".join(sorted(models, key=difference)[:3])
    return f"{device} is no known model; nearest: {near}"


def _similarity(device: str, driver: DriverFamily) -> float:
    """Similarity of a misspelt device to the nearest model of a family, 0 to 1."""
    return max(SequenceMatcher(None, device.upper(), each.upper()).ratio() for each in driver.models())
