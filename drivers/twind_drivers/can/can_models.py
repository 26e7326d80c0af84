"""CAN actuator models by their names in a robot file: family, field ranges, supply and heat limits. Pure.

Sources. Damiao: ranges from lerobot's table, supply and heat from the vendor's table of motors and its
debugging tool (Seeed wiki, Damiao series). The two disagree on DM3507 and the 48 V types; every motor reports
its own ranges, which take precedence. CubeMars: AK manual V1.0.8 for AK70-10 and AK80-64, public drivers for
the others (TMotorCANControl); those give 120 N·m for AK80-64, the manual 144. RobStride: vendor's sample
program for RS01, lerobot for the others. Its speeds of RS02 to RS04 are doubtful, so is its position range of
RS06, which is left out. Gains of RS03, RS04 and RS06 from takarakasai/robstride-driver, which cites the
manual: if they were 500 and 5, the joint would be softer than requested, not stiffer. CubeMars and RobStride
report no ranges: confirm them by moving. ODrive: ranges of the fields.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from types import MappingProxyType

from twind_drivers.can.mit_frame import KD, KP

NAN = math.nan


@dataclass(frozen=True, slots=True)
class CanActuatorModel:
    """One model. Ranges are symmetric about 0; NaN: no source gives it, so the robot file must."""

    name: str
    number: int  # assigned here, never changed: calibrations record it. Beyond 16 bits: no serial servo's
    family: str  # damiao, cubemars, robstride, odrive
    position: float  # rad
    velocity: float  # rad/s
    torque: float  # N·m
    kp: float = KP  # N·m/rad, from 0
    kd: float = KD  # N·m·s/rad, from 0
    supply: tuple[float, float] | None = None  # V; None: not known
    heat: float | None = None  # °C of the winding that the vendor advises not to pass; None: not known


# Damiao's recommended supplies
V24 = (15.0, 32.0)
V48 = (15.0, 52.0)
COIL = 100.0  # °C, Damiao: "recommended" over-temperature threshold
TURNS_FED = 32.767 * 2.0 * math.pi  # rad/s: the velocity that ODrive's 16-bit feed-forward holds
ODRIVE_GAIN = 1e4  # no field: kp and kd of an ODrive are floats
FOUR_PI = 12.57
# of the large RobStride
STRONG_KP = 5000.0
STRONG_KD = 100.0

_ALL = (
    CanActuatorModel("DM3507", 71001, "damiao", 12.5, 30.0, 10.0, supply=(15.0, 30.0), heat=COIL),
    CanActuatorModel("DM4310", 71002, "damiao", 12.5, 30.0, 10.0, supply=V24, heat=COIL),
    CanActuatorModel("DM4310-48V", 71003, "damiao", 12.5, 50.0, 10.0, supply=V48, heat=COIL),
    CanActuatorModel("DM4340", 71004, "damiao", 12.5, 8.0, 28.0, supply=V24, heat=COIL),
    CanActuatorModel("DM4340-48V", 71005, "damiao", 12.5, 10.0, 28.0, supply=V48, heat=COIL),
    CanActuatorModel("DM6006", 71006, "damiao", 12.5, 45.0, 20.0, supply=V48, heat=COIL),
    CanActuatorModel("DM8006", 71007, "damiao", 12.5, 45.0, 40.0, supply=V48, heat=COIL),
    CanActuatorModel("DM8009", 71008, "damiao", 12.5, 45.0, 54.0, supply=V48, heat=COIL),
    CanActuatorModel("DM10010L", 71009, "damiao", 12.5, 25.0, 200.0, supply=V48, heat=COIL),
    CanActuatorModel("DM10010", 71010, "damiao", 12.5, 20.0, 200.0, supply=V48, heat=COIL),
    CanActuatorModel("DMH3510", 71011, "damiao", 12.5, 280.0, 1.0, heat=COIL),
    CanActuatorModel("DMH6215", 71012, "damiao", 12.5, 45.0, 10.0, heat=COIL),
    CanActuatorModel("DMG6220", 71013, "damiao", 12.5, 45.0, 10.0, heat=COIL),
    CanActuatorModel("AK70-10", 72001, "cubemars", 12.5, 50.0, 25.0),
    CanActuatorModel("AK80-64", 72002, "cubemars", 12.5, 8.0, 144.0),
    CanActuatorModel("AK80-6", 72003, "cubemars", 12.5, 50.0, 12.0),
    CanActuatorModel("AK80-8", 72004, "cubemars", 12.5, 50.0, 25.0),
    CanActuatorModel("AK80-9", 72005, "cubemars", 12.5, 50.0, 18.0),
    CanActuatorModel("RS00", 73000, "robstride", FOUR_PI, 33.0, 14.0, supply=(24.0, 60.0)),
    CanActuatorModel("RS01", 73001, "robstride", 12.5, 44.0, 17.0),
    CanActuatorModel("RS02", 73002, "robstride", FOUR_PI, 33.0, 20.0, supply=(24.0, 60.0)),
    CanActuatorModel("RS03", 73003, "robstride", FOUR_PI, 33.0, 60.0, STRONG_KP, STRONG_KD),
    CanActuatorModel("RS04", 73004, "robstride", FOUR_PI, 33.0, 120.0, STRONG_KP, STRONG_KD),
    CanActuatorModel("RS05", 73005, "robstride", FOUR_PI, 50.0, 5.5),
    CanActuatorModel("EL05", 73006, "robstride", FOUR_PI, 50.0, 6.0),
    CanActuatorModel("RS06", 73007, "robstride", NAN, 50.0, 36.0, STRONG_KP, STRONG_KD),
    # ODrive 3.x; its heartbeat and error numbers differ from those of the later boards.
    CanActuatorModel("ODrive", 74001, "odrive", NAN, TURNS_FED, 32.767, ODRIVE_GAIN, ODRIVE_GAIN),
    CanActuatorModel("ODrive-S1", 74002, "odrive", NAN, TURNS_FED, 32.767, ODRIVE_GAIN, ODRIVE_GAIN),
    CanActuatorModel("ODrive-Pro", 74003, "odrive", NAN, TURNS_FED, 32.767, ODRIVE_GAIN, ODRIVE_GAIN),
)
MODELS: Mapping[str, CanActuatorModel] = MappingProxyType({model.name: model for model in _ALL})


def model(name: str) -> CanActuatorModel:
    """The model of that name, spelled as in `MODELS`. Raises KeyError that lists the nearest."""
    found = MODELS.get(name)
    if found is None:
        spelled = {known.lower(): known for known in MODELS}
        near = [spelled[key] for key in get_close_matches(name.lower(), spelled, 3, 0.5)]
        known = ", ".join(near or MODELS)
        raise KeyError(f"no CAN actuator {name!r}: {'nearest' if near else 'known'} are {known}")
    return found


def number_of(name: str) -> int:
    """The number that a calibration records of a model. Raises KeyError that lists the nearest names."""
    return model(name).number
