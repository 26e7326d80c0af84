"""CAN bus of a robot in its two halves: reader (mirror and live) and writer (live only)."""

import numpy as np

from twind.config.driver_family import BusDriver, BusSetup
from twind_drivers.bus import BusReader
from twind_drivers.bus_writer import BusWriter
from twind_drivers.can.actuator import CanActuatorIdentity
from twind_drivers.can.can_reader import CanReader
from twind_drivers.can.can_type import CanType
from twind_drivers.can.can_writer import CanWriter
from twind_drivers.ports.channel import CanChannel


def _reader(setup: BusSetup, channel: CanChannel) -> BusReader:
    actuators = [
        CanActuatorIdentity(
            id=joint.id,
            feedback_id=joint.id if joint.feedback_id is None else joint.feedback_id,
            model=kind.device,
            position=kind.ranges.position_rad,
            velocity=kind.ranges.velocity_rad_s,
            torque=kind.ranges.torque_nm,
        )
        for joint, kind in zip(setup.joints, _types(setup), strict=True)
    ]
    return CanReader(setup.bus.name, channel, actuators, bitrate=setup.bus.baud, rate_hz=setup.rate_hz)


def _writer(setup: BusSetup, reader: BusReader) -> BusWriter:
    assert isinstance(reader, CanReader)
    kinds = _types(setup)
    return CanWriter(
        reader,
        lower=setup.lower,
        upper=setup.upper,
        kp=np.array([kind.gains.kp for kind in kinds]),
        kd=np.array([kind.gains.kd for kind in kinds]),
        torque_limits=np.array([kind.torque_limit_nm for kind in kinds]),
        watchdog=[kind.watchdog == "device" for kind in kinds],
    )


def _types(setup: BusSetup) -> list[CanType]:
    return [joint.type for joint in setup.joints if isinstance(joint.type, CanType)]


DRIVER = BusDriver(reader=_reader, writer=_writer)
