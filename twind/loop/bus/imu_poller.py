"""The IMU of a robot: schedule of its readings and meaning of its registers. One transaction a tick.

It is read after the servos. A silent IMU keeps its last values with their time, and stops nothing. A reading
of the servos that its late reply spoils counts as its error, not as that of their bus. Only this module
converts its registers to SI.
"""

from math import isfinite

import numpy as np

from twind.config.robot_spec import ImuSpec
from twind.loop.bus.bus_port import SOON, BusPort
from twind.robot.arrays import Floats, every
from twind.robot.attitude import Attitude, G, Quaternion, conjugate, matrix, product, unit
from twind.robot.joint_state import Imu
from twind_drivers.bus import BusSample
from twind_drivers.register_sensor import Sensor, SensorField

UNIT = 0.1  # deviation of a quaternion's length from 1; beyond it the value is no attitude
# rad/s, m/s²: more than a robot can have and stay whole
SPIN = 200.0
SHOCK = 100.0 * G
CALM = 5.0  # s without a failure after which it is reported as sound again
SILENT = "it does not answer, or not soundly"
TARDY = "its answers come late"
HARMS = "its late answers spoil readings of the servos"
REMEDY = "is left alone but for probes; check its cable, its power, and return_delay_us"


class ImuPoller:
    """One IMU on the bus of that number among the ports. Times in s."""

    def __init__(self, spec: ImuSpec, mount: Quaternion, bus: int) -> None:
        """`mount`: rotation from the sensor's axes to the base's."""
        self.bus = bus
        self.imu: Imu | None = None  # the last reading
        self.asked = self.missed = self.late = self.spoilt = 0
        self._name = f"imu (id {spec.id})"
        self._faults = set[str]()
        self._sensor = Sensor(
            spec.id, [SensorField(each.address, each.kind, each.count) for each in spec.registers]
        )
        turn = matrix(mount)
        self._gyro = turn * spec.gyro.lsb
        self._force = turn * spec.acceleration.lsb
        self._zeros = [each.zero for each in spec.registers]
        self._quaternion_spec = spec.quaternion
        self._back = conjugate(mount)
        self._attitude = Attitude()
        self._waited = 0  # ticks without room

    @property
    def parked(self) -> bool:
        """True after too many failures: the IMU is probed only."""
        return self._sensor.parked

    def trouble(self, now: float) -> str:
        """Return the IMU's worst problem as a text for people, with the remedy; empty: none."""
        if not self._faults or self._sensor.calm(now, CALM):
            self._faults.clear()
            return ""
        worst = next(each for each in (HARMS, TARDY, SILENT) if each in self._faults)
        return f"{self._name}: {worst}: it {REMEDY}"

    def listen(self, sample: BusSample) -> bool:
        """Process the servos' reading and the bytes in between; True: a reply of this device spoilt it.

        Such a reading is no fault of the bus. At most one is accepted per request that was not answered in
        time.
        """
        now = sample.sent
        paid = [size for size in sample.late if self._sensor.late(size, now)]
        self.late += len(sample.late)
        if self._sensor.parked and paid:
            self._faults.add(TARDY)
        if not (sample.discarded or (paid and not every(sample.heard | ~sample.asked))):
            return False
        if not (paid or self._sensor.owes(now)):
            return False
        self._sensor.spoil(now)
        self._faults.add(HARMS)
        self.spoilt += 1
        return True

    def begin(self, port: BusPort, now: float, end: float) -> bool:
        """Request a reading if it ends before `end` (s) and no more urgent request waits.

        Raises PortError.

        Without room it is requested after `SOON` ticks anyway: a robot balances by it.
        """
        reader = port.reader
        port.beside = self.trouble(now)
        if reader is None or port.resting or port.hurried:
            return False
        if now + reader.span(self._sensor.query) > end and self._waited < SOON:
            self._waited += 1
            return False
        self._waited = 0
        query = self._sensor.ask(now)
        if query is None:
            return False
        self.asked += 1
        reader.begin(query, now)
        return True

    def end(self, port: BusPort, now: float) -> None:
        """Take the reply that was complete at `now` (s)."""
        if port.reader is None:
            self._sensor.forget()
            return
        reply = port.reader.answer(now)
        port.counts.busy += reply.waited
        port.counts.discarded += reply.strays
        found = self._sensor.take(reply, now)
        imu = None if found is None else self.make_reading(found, now)
        self.missed += imu is None
        if self._sensor.parked:
            self._faults.add(SILENT)
        self.imu = imu or self.imu

    def make_reading(self, raw: list[Floats], now: float) -> Imu | None:
        """Return the registers in SI; None for values that a robot cannot have."""
        if not all(np.isfinite(each).all() for each in raw) or _blank(raw, self._zeros[1]):
            return None
        gyro = self._gyro @ (raw[0] - self._zeros[0])
        force = self._force @ (raw[1] - self._zeros[1])
        if not (np.linalg.norm(gyro) <= SPIN and np.linalg.norm(force) <= SHOCK):
            return None
        turned = (
            self._attitude.update(gyro, force, now) if self._quaternion_spec is None else self._device(raw[2])
        )
        if turned is None:
            return None
        quaternion = np.array(turned)
        for values in (gyro, force, quaternion):
            values.setflags(write=False)
        return Imu(now, gyro, force, quaternion)

    def _device(self, raw: Floats) -> Quaternion | None:
        """Return the attitude that the device reports; None: the value is none."""
        assert self._quaternion_spec is not None
        w, x, y, z = ((raw - self._zeros[2]) * self._quaternion_spec.lsb).tolist()
        if self._quaternion_spec.order == "xyzw":
            w, x, y, z = z, w, x, y
        size = float(np.sqrt(w * w + x * x + y * y + z * z))
        if not (isfinite(size) and abs(size - 1.0) <= UNIT):
            return None
        return product(unit((w, x, y, z)), self._back)


def _blank(raw: list[Floats], zero: float) -> bool:
    """Check for registers of a chip that sleeps, boots or is gone.

    An accelerometer is noisy and never reads all zeros, also in free fall; six equal values never occur.
    """
    force = raw[1]
    same = bool((np.concatenate(raw[:2]) == force[0]).all())
    return same or not force.any() or not (force - zero).any()
