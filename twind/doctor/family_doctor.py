"""Doctor of a driver family: the inspections of its buses, and the access to one that is free.

A family's record names its `FamilyDoctor` (`DriverFamily.doctor`).
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from twind.client import NoDaemon
from twind.config.driver_family import DriverFamily, families
from twind.config.robot_spec import BusSpec, JointSpec, RobotFile
from twind.doctor.host_inspector import HostInspector
from twind_drivers.clock import Clock


@dataclass(frozen=True, slots=True)
class InspectorRequest:
    """One free bus, to be opened when it is first used."""

    port: str
    bus: BusSpec
    robot: RobotFile
    host: HostInspector
    clock: Clock
    no_daemon: NoDaemon | None  # why no daemon was reached


@dataclass(frozen=True, slots=True)
class SurveyedDevice:
    """A device that answered, as `twindctl calibrate scan` lists it."""

    bus: str
    id: int
    joint: str | None  # None: the robot file has no such device
    model: str | int | None
    firmware: int | None  # None: it does not report it
    values: Mapping[str, int]  # registers that were read, by name


class DeviceSurvey(ABC):
    """Survey of one bus by the doctor of its family."""

    @property
    @abstractmethod
    def devices(self) -> tuple[SurveyedDevice, ...]:
        """Devices that answered, in the order of the survey."""


@dataclass(frozen=True, slots=True)
class FamilyDoctor:
    """Inspections of the buses of one family.

    A subject is a module with `ROWS` (`Check`) and `CHECKS` (`Inspection`). An inspector has `close`; one of
    a serial bus also `port`, `transport`, `ping_delays` and `ping_time`, for the checks of the adapter.
    """

    subjects: Sequence[Any]
    inspector: Callable[[InspectorRequest], Any]
    at_calibration: Collection[str]  # inspections (`Inspection.what`) that `twindctl calibrate scan` runs too
    # Wire time (s) of one plain reading; of families on serial buses.
    reading_time: Callable[[BusSpec, Sequence[JointSpec]], float] = lambda bus, joints: 0.0


def doctor_of(driver: DriverFamily) -> FamilyDoctor:
    """Return the doctor of a family that has one, imported."""
    assert driver.doctor is not None
    found: FamilyDoctor = driver.doctor.load()
    return found


def doctors() -> list[FamilyDoctor]:
    """List the doctors of all installed families, one that several share once."""
    found = [doctor_of(each) for each in reversed(families()) if each.doctor is not None]
    return list({id(each): each for each in found}.values())


def family_subjects() -> list[Any]:
    """List the subjects of all installed families, those that several share once."""
    return list(dict.fromkeys(subject for each in doctors() for subject in each.subjects))
