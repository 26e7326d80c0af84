"""Section `transmissions` of a robot file: who turns whom where an actuator has no joint of its own. Checked.

As many actuators as joints, all on one bus: where the joints are is known by one reading of all of them.
"""

from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Literal

from twind.config.bus_config import NAME
from twind.config.config_reader import ConfigReader, ConfigStruct, Text
from twind.config.linkage_file import linkage
from twind.config.robot_spec import ActuatorSlot, TransmissionSpec
from twind.robot.transmission import MOST_CONDITION, Differential, Transmission, condition

DIFFERENTIAL = "differential"


class TransmissionKeys(ConfigStruct):
    """Entry of `transmissions`, of any kind."""

    kind: Literal["differential", "linkage_table"]
    actuators: tuple[str, ...]
    """actuators | | as many as joints"""


class DifferentialKeys(TransmissionKeys):
    """Entry of a differential: of each joint its rad per rad of each actuator."""

    joints: ConfigReader
    """numbers | | `differential`: joint rad per rad of each actuator"""


class LinkageKeys(TransmissionKeys):
    """Entry of a linkage that a table describes."""

    joints: tuple[str, ...]
    """joints | | `linkage_table`: as many as actuators"""
    table: Text
    """CSV file | | `linkage_table` only"""


def transmissions(
    section: ConfigReader,
    slots: Mapping[str, ActuatorSlot],
    actuators: ConfigReader,
    joints: ConfigReader,
    folder: Path,
) -> tuple[TransmissionSpec, ...]:
    """All of them. `slots`: the actuators by name; a table is sought from `folder`. Raises ConfigError.

    Refused: an actuator or a joint that is not there, that stands in two, an actuator in none.
    """
    found: list[TransmissionSpec] = []
    taken: tuple[dict[str, str], dict[str, str]] = ({}, {})  # actuator, joint -> its transmission
    for name, entry in section.sections(NAME).items():
        found.append(_transmission(name, entry, slots, tuple(joints), taken, folder))
        for names, of_it in zip(taken, (found[-1].actuators, found[-1].joints), strict=True):
            names |= dict.fromkeys(of_it, name)
    for name in slots:
        if name not in taken[0]:
            why = "stands in no transmission; an actuator that turns one joint stands with its joint"
            raise actuators.refuse(name, why)
    return tuple(found)


def _transmission(
    name: str,
    section: ConfigReader,
    slots: Mapping[str, ActuatorSlot],
    joints: tuple[str, ...],
    taken: tuple[Mapping[str, str], Mapping[str, str]],
    folder: Path,
) -> TransmissionSpec:
    kind = section.read(TransmissionKeys, DifferentialKeys, LinkageKeys).kind
    given: DifferentialKeys | LinkageKeys = (
        section.read(DifferentialKeys) if kind == DIFFERENTIAL else section.read(LinkageKeys)
    )
    actuators = given.actuators
    driven = tuple(given.joints)
    _check_joint_names(section, "actuators", actuators, tuple(slots), taken[0])
    _check_joint_names(section, "joints", driven, joints, taken[1])
    if len(actuators) != len(driven):
        counts = f"{len(actuators)} actuators for {len(driven)} joints"
        raise section.refuse("actuators", f"{counts}: as many are needed, else nobody knows who does what")
    buses = sorted({slots[each].bus for each in actuators})
    if len(buses) > 1:
        where = ", ".join(f"{each} on {slots[each].bus}" for each in actuators)
        raise section.refuse("actuators", f"{where}: all of a transmission must be on one bus")
    residual = 0.0
    table = None
    sha256 = ""
    if isinstance(given, DifferentialKeys):
        law: Transmission = _differential(section, given.joints)
    else:
        table = folder / given.table
        read = linkage(table, actuators, driven)
        law = read.law
        residual = read.residual
        sha256 = read.sha256
    worst = condition(law)
    if not worst <= MOST_CONDITION:
        reason = "one per cent of an actuator's angle or torque would be all of a joint's"
        raise section.refuse(
            "joints" if table is None else "table",
            f"nearly singular: condition number {worst:.3g}, {MOST_CONDITION:g} at most; beyond it {reason}",
        )
    return TransmissionSpec(name, kind, buses[0], actuators, driven, law, worst, residual, table, sha256)


def _check_joint_names(
    section: ConfigReader, key: str, names: tuple[str, ...], known: tuple[str, ...], taken: Mapping[str, str]
) -> None:
    """Raises ConfigError unless all are there, each once, and in no other transmission."""
    if not names:
        raise section.refuse(key, f"is required and missing: a transmission needs {key}")
    for name in names:
        if name not in known:
            near = get_close_matches(name, known, 1)
            hint = f"; nearest: {near[0]}" if near else ""
            raise section.refuse(key, f"no {key.removesuffix('s')} {name!r}{hint}")
        if (other := taken.get(name)) is not None:
            raise section.refuse(key, f"{name} stands in transmission {other} already")
    if len(set(names)) != len(names):
        raise section.refuse(key, "a name stands there twice")


def _differential(section: ConfigReader, rows: ConfigReader) -> Differential:
    matrix: list[tuple[float, ...]] = [rows.value(joint, tuple[float, ...]) for joint in rows]
    for joint, row in zip(rows, matrix, strict=True):
        if len(row) != len(matrix):
            raise rows.refuse(joint, f"needs {len(matrix)} numbers, found {len(row)}")
    try:
        return Differential(matrix)
    except ValueError as error:
        raise section.refuse("joints", f"{error}: the joints do not move independently") from None
