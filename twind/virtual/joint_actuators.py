"""Joint actuators of a virtual robot: zeros, hinges, servos with their settings, and their readings."""

import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twind.config.actuator_types import CanType, ServoType
from twind.config.counts import rad_per_tick, tick_range
from twind.config.robot_spec import JointSpec
from twind.config.travel import sweep_range, travel_refusal, zero_range
from twind.exceptions import InvalidInput
from twind.virtual.robot_ground_truth import JointGroundTruth
from twind_drivers.can.can_units import COUNT
from twind_drivers.dynamixel.control_tables import number_of, table
from twind_drivers.virtual.hinge import Hinge
from twind_drivers.virtual.servo_physics import FirstOrderPhysics
from twind_drivers.virtual.virtual_servos import ServoSpec, VirtualServos

SCATTER = 400  # ticks either side of the middle of what the travel allows


@dataclass(frozen=True, slots=True)
class EncoderFrame:
    """Conversion of the position of a bare encoder to the position register, in counts."""

    direction: int = 1
    shift: int = 0  # whole turns and the homing offset

    def shown(self, place: int) -> int:
        """Return the register value at that encoder position."""
        return self.direction * place + self.shift


def zero_of(robot: str, joint: JointSpec, truth: JointGroundTruth) -> int:
    """Return the encoder position at joint angle 0: from the truth, else fixed by the names.

    That keeps the travel on one turn, clear of the seam. `joint` as it is wired. Raises InvalidInput.
    """
    if truth.zero_ticks is not None:
        return truth.zero_ticks
    refusal = travel_refusal(joint)
    if refusal is not None:
        raise InvalidInput(f"{joint.name}: {refusal}")
    first, last = zero_range(joint)
    middle = (first + last) // 2
    first = max(first, middle - SCATTER)
    last = min(last, middle + SCATTER)
    return first + zlib.crc32(f"{robot}/{joint.name}".encode()) % (last - first + 1)


def hinge_of(joint: JointSpec, zero: int, ends: Mapping[str, tuple[float, float]]) -> Hinge:
    """Make the hinge of `joint` as it is wired."""
    unit = COUNT if isinstance(joint.type, CanType) else 1.0  # the places of CAN actuators are rad
    scale = unit / rad_per_tick(joint)
    return Hinge(joint.name, zero * unit, scale, ends.get(joint.name, (-math.inf, math.inf)))


def servo_of(
    joint: JointSpec, hinge: Hinge, truth: JointGroundTruth, id: int, base: Mapping[str, int], firmware: int
) -> ServoSpec:
    """The servo at a joint, without limits of its own; `base`: registers of all of its bus."""
    assert isinstance(joint.type, ServoType)
    described = {"return_delay_time": joint.type.return_delay_us // 2, "operating_mode": joint.operating_mode}
    return ServoSpec(
        id,
        joint.type.device,
        described | dict(base) | dict(joint.registers) | truth.eeprom(),
        firmware if truth.firmware is None else truth.firmware,
        forgets_offset=truth.forgets_offset,
        seam_seed=truth.seam_seed,
        hinge=hinge,
        turns=truth.turns,
        backlash=truth.backlash_ticks,
    )


def frames_of(bus: str, specs: Sequence[ServoSpec], start: Sequence[int]) -> list[EncoderFrame]:
    """Return the encoder frames of these servos after a boot there. Raises InvalidInput."""
    asleep = [replace(spec, turns=0, backlash=0.0) for spec in specs]
    try:
        servos = VirtualServos(asleep, FirstOrderPhysics(np.array(start, np.float64)))
    except (KeyError, ValueError, OverflowError) as error:
        raise InvalidInput(f"bus {bus}: {error.args[0]}") from None
    return [
        EncoderFrame(int(way), int(shift)) for way, shift in zip(servos.direction, servos.shift, strict=True)
    ]


def fenced(spec: ServoSpec, joint: JointSpec, zero: int, frame: EncoderFrame) -> ServoSpec:
    """Set the servo's own limits around the travel; as delivered if one turn of registers cannot hold it."""
    ends = tick_range(joint, zero, *sweep_range(joint))
    low, high = sorted(frame.shown(end) for end in ends)
    register = table(number_of(spec.model), spec.firmware)["min_position_limit"]
    if not (register.takes(low) and register.takes(high)):
        return spec
    limits = {"min_position_limit": low, "max_position_limit": high}
    return replace(spec, settings=limits | dict(spec.settings))
