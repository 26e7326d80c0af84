"""Result of a model import: plain values in SI units. Knows no file format, no MuJoCo and no process."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from twind.bounded_process import MAX_MESSAGE, refused_in_one_line
from twind.exceptions import InvalidInput


def import_refused(reason: str, *, where: str = "") -> InvalidInput:
    """Return the error of a model that cannot be imported: one line, `file:line:column: reason; remedy`."""
    return refused_in_one_line(reason, where=where)


@dataclass(frozen=True, slots=True)
class ImportRemark:
    """One thing that the import dropped or assumed."""

    place: str  # `file:line:column`, or the file
    text: str

    def __str__(self) -> str:
        return f"{self.place}: {self.text}"


@dataclass(frozen=True, slots=True)
class JointMimic:
    """A joint that follows another one: position = multiplier * position of `joint` + offset."""

    joint: str  # the joint that moves freely, also where the file has a chain
    multiplier: float
    offset: float  # rad


@dataclass(frozen=True, slots=True)
class ImportedJoint:
    """One joint of the model that moves."""

    name: str
    kind: Literal["hinge", "slide"]
    body: str  # the body that the joint moves
    axis: tuple[float, float, float]  # unit vector in the frame of `body`
    range: tuple[float, float] | None  # rad (slide: m); None: unlimited
    velocity: float | None  # rad/s (slide: m/s); None: the file has no limit
    effort: float | None  # N·m (slide: N); None: the file has no limit
    mimic: JointMimic | None
    place: str  # `file:line:column` of its definition


@dataclass(frozen=True, slots=True)
class HardwareJoint:
    """One joint of a `ros2_control` section, with the device that drives it."""

    joint: str
    device: str  # name of the `<gpio>` that stands for the actuator; the joint where there is none
    id: int | None
    model: str | None
    commands: tuple[str, ...]  # command interfaces, of the joint and of the device
    parameters: Mapping[str, str]  # of joint and device, as the file has them
    reduction: float | None  # turns of the actuator per turn of the joint
    offset: float | None  # rad, of the joint
    place: str


@dataclass(frozen=True, slots=True)
class HardwareSystem:
    """One `ros2_control` section: the devices behind one port."""

    name: str
    plugin: str
    port: str | None
    baud: int | None
    parameters: Mapping[str, str]  # as the file has them
    joints: tuple[HardwareJoint, ...]
    place: str


@dataclass(frozen=True, slots=True)
class ImportedModel:
    """A model in MuJoCo's format, and what the source says beside it."""

    name: str
    file: Path  # MJCF, beside its folder `meshes`
    base: str  # body that carries all others
    floating: bool  # the base has a free joint
    mass: float  # kg, of all bodies
    joints: tuple[ImportedJoint, ...]
    hardware: tuple[HardwareSystem, ...] = ()
    remarks: tuple[ImportRemark, ...] = ()


@dataclass(slots=True)
class RemarkList:
    """Remarks in the order in which they were made, each once."""

    entries: list[ImportRemark] = field(default_factory=list)

    def add(self, place: str, text: str) -> None:
        """Add one remark, unless it is there already."""
        remark = ImportRemark(place, " ".join(text.split())[:MAX_MESSAGE])
        if remark not in self.entries:
            self.entries.append(remark)
