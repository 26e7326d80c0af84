"""Setup of the CAN actuators of a virtual robot: their settings, their physics, their calibration data."""

from collections.abc import Sequence
from math import isfinite

import numpy as np

from twind.config.robot_spec import JointSpec
from twind_drivers.bus import IdentifiedDevice
from twind_drivers.can.can_keys import FEEDBACK
from twind_drivers.can.can_models import MODELS, number_of
from twind_drivers.can.can_type import TAKES_COMMANDS, CanType
from twind_drivers.can.can_units import COUNT, counts
from twind_drivers.virtual.can.can_motor_physics import FirstOrderCanPhysics
from twind_drivers.virtual.can.node_spec import NodeSpec

FIRMWARE = 1
SPAN = 12.5  # rad, of a model whose position is a float


def node(joint: JointSpec) -> NodeSpec:
    """The actuator of a joint, as its robot file describes it; its watchdog is off, as from the factory."""
    kind = joint.type
    assert isinstance(kind, CanType)
    return NodeSpec(
        joint.id,
        kind.device,
        feedback_id=joint.feedback_id or 0,
        position=kind.ranges.position_rad,
        velocity=kind.ranges.velocity_rad_s,
        torque=kind.ranges.torque_nm,
        firmware=FIRMWARE,
        family=kind.family,
    )


def default_node(id: int, model: str) -> NodeSpec:
    """One by its model alone, as from the factory. Raises KeyError: no such model."""
    known = MODELS[model]
    return NodeSpec(
        id,
        model,
        feedback_id=id + FEEDBACK if known.family == "damiao" else 0,
        position=known.position if isfinite(known.position) else SPAN,
        velocity=known.velocity,
        torque=known.torque,
        firmware=FIRMWARE,
        family=known.family,
    )


def device(spec: NodeSpec) -> IdentifiedDevice:
    """Return the identification of a node, as far as a calibration records it."""
    span = int(counts(spec.position))
    settings = {
        "homing_offset": 0,
        "drive_mode": 0,
        "operating_mode": TAKES_COMMANDS,
        "min_position_limit": -span,
        "max_position_limit": span,
    }
    unique = f"{spec.number:016x}" if spec.spoken() == "robstride" else None
    return IdentifiedDevice(spec.id, number_of(spec.model), spec.model, spec.firmware, settings, unique)


def unloaded(places: Sequence[int], *, now: float = 0.0) -> FirstOrderCanPhysics:
    """Shafts without load that stand at these counts."""
    return FirstOrderCanPhysics(np.array(places, np.float64) * COUNT, now=now)


def scattered(count: int, seed: int, now: float) -> FirstOrderCanPhysics:
    """Make shafts without load at positions within half a radian of their zeros, by the seed."""
    random = np.random.default_rng(seed)
    return FirstOrderCanPhysics(random.uniform(-0.5, 0.5, count), now=now)
