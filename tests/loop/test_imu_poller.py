"""The IMU in the daemon: the whole loop and driver on virtual servos and a virtual IMU; a fake clock."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from math import inf, nan, radians
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.support.daemon_rig import Rig
from tests.support.imu_rig import Standing
from twind import link
from twind.config.robot_spec import ImuSpec, RegistersSpec
from twind.link import Tick
from twind.loop.bus.imu_poller import SHOCK, SPIN, ImuPoller
from twind.robot.attitude import G, matrix
from twind.robot.modes import Mode
from twind.twin.base_pose import BASES
from twind.virtual.virtual_robot_spec import body_for, buses, sensor_of
from twind_drivers.register_sensor import decoded

ODD = st.sampled_from([inf, -inf, nan, 3e38, -3e38, 0.0, 9.8, 1e-38, 0.5])


class Lying(Standing):
    """The same in MuJoCo, its base pinned as somebody laid it."""

    def __init__(self, base: str, **imu: Any) -> None:
        self._base = base
        super().__init__(**imu)

    def _virtual(self, bus: str, start: Any) -> Any:
        super()._virtual(bus, start)
        made = replace(self.made, robot=self.robot)
        body = body_for(made, base=self._base, now=self.clock.now())
        return buses(made, physics=False, body=body, now=self.clock.now())[bus]


Made = Callable[..., Any]


@pytest.fixture
def rigs() -> Iterator[Made]:
    """Makes daemons, and ends them."""
    with ExitStack() as ending:

        def made(kind: type[Rig], *given: Any, **how: Any) -> Rig:
            rig = kind(*given, **how)
            ending.callback(rig.close)
            return rig

        yield made


def test_every_tick_has_its_own_reading_in_mirror_and_live(rigs: Made) -> None:
    for mode in (Mode.MIRROR, Mode.LIVE):
        rig = rigs(Standing, mode)
        rig.connect()
        times = []
        for _ in range(50):
            rig.ticks(1)
            times.append(rig.imu.time)
            assert rig.imu.acceleration == pytest.approx([0.0, 0.0, G], abs=0.005)
            assert rig.imu.gyro.tolist() == [0.0, 0.0, 0.0]
            assert rig.imu.quaternion == pytest.approx([1.0, 0.0, 0.0, 0.0])
        assert np.diff(times) == pytest.approx(rig.loop.robot.period, abs=1e-4)
        assert rig.loop.hardware.inertial.missed == 0


@pytest.mark.parametrize("base", BASES)
@pytest.mark.parametrize("source", ["device", "filter"])
def test_the_imu_gives_the_direction_of_gravity_in_any_pose(base: str, source: str, rigs: Made) -> None:
    """By the quaternion of the device, and by the filter where it tells none."""
    rig = rigs(Lying, base, **({"quaternion": None} if source == "filter" else {}))
    rig.connect()
    rig.ticks(5)
    up = -np.array(BASES[base])
    assert rig.imu.acceleration == pytest.approx(G * up, abs=0.02)
    w, x, y, z = rig.imu.quaternion.tolist()
    assert pytest.approx(up, abs=0.002) == matrix((w, x, y, z)).T @ [0.0, 0.0, 1.0]


@pytest.mark.parametrize("order", ["wxyz", "xyzw"])
def test_mounting_and_register_format_of_the_imu_do_not_change_its_reading(order: str, rigs: Made) -> None:
    """A quarter turn about x and one about z, unsigned registers with an offset: the base hears the same."""
    rig = rigs(Standing)
    quaternion = rig.spec.quaternion
    assert quaternion is not None
    force = replace(rig.spec.acceleration, type="uint16", zero=32768.0)
    quaternion = replace(quaternion, type="float32", size=4, lsb=1.0, order=order)
    rig = rigs(Lying, "left", rotation=(0.5, 0.5, 0.5, 0.5), acceleration=force, quaternion=quaternion)
    rig.connect()
    rig.ticks(3)
    up = -np.array(BASES["left"])
    assert rig.imu.acceleration == pytest.approx(G * up, abs=0.02)
    w, x, y, z = rig.imu.quaternion.tolist()
    assert pytest.approx(up, abs=0.002) == matrix((w, x, y, z)).T @ [0.0, 0.0, 1.0]


def test_in_sim_it_is_that_of_the_simulation(rigs: Made) -> None:
    rig = rigs(Standing, Mode.SIM)
    rig.seconds(1.0)
    found = rig.loop.robot.simulated.imu
    assert found is not None and rig.loop.robot.measured.imu is None
    assert np.linalg.norm(found.acceleration) == pytest.approx(G, rel=0.01)
    told = rig.reported_ticks[-1]
    assert np.frombuffer(told.imu)[3:6] == pytest.approx(found.acceleration)
    assert told.imu_age == 0.0


# ------------------------------------------------------------------------------------------- faults


def test_a_silent_imu_costs_no_servo_a_reading_and_keeps_its_last_with_its_time(rigs: Made) -> None:
    rig = rigs(Standing, Mode.LIVE)
    rig.arm()
    rig.seconds(0.5)
    bus = rig.virtual["main"]
    before = rig.imu
    errors = rig.loop.hardware.ports[0].counts.errors
    exchanges = rig.loop.hardware.ports[0].counts.exchanges
    missed = rig.loop.figures.missed
    bus.faults.silence(rig.spec.id)
    rig.seconds(5.0)
    assert rig.imu.time == before.time and (rig.imu.quaternion == before.quaternion).all()
    assert rig.reported_ticks[-1].imu_age == pytest.approx(5.0, abs=0.05)
    assert rig.loop.hardware.ports[0].counts.errors == errors
    assert rig.loop.hardware.ports[0].counts.exchanges - exchanges == 500
    assert rig.loop.figures.missed == missed
    assert rig.loop.robot.measured.heard.all() and rig.loop.torque.armed and not rig.loop.condition.latches
    assert rig.loop.hardware.inertial.parked
    bus.faults.silence(rig.spec.id, on=False)
    rig.seconds(1.2)
    assert rig.loop.robot.measured.time - rig.imu.time < 0.02, "it is back"


@pytest.mark.parametrize("fault", ["drop", "corrupt", "duplicate", "cut", "noise"])
def test_a_noisy_imu_costs_no_servo_a_reading(fault: str, rigs: Made) -> None:
    """And what is wrong of it is no reading: acceleration stays what it is."""
    rig = rigs(Standing, Mode.LIVE)
    rig.arm()
    rig.seconds(0.3)
    errors = rig.loop.hardware.ports[0].counts.errors
    given = {"count": 40, "id": rig.spec.id}
    given |= {"cut": {"bytes": 9}, "noise": {"seconds": 0.0005}}.get(fault, {})
    getattr(rig.virtual["main"].faults, fault)(**given)
    for _ in range(60):
        rig.ticks(1)
        assert rig.imu.acceleration == pytest.approx([0.0, 0.0, G], abs=0.005)
        assert rig.loop.robot.measured.heard.all()
    assert rig.loop.hardware.ports[0].counts.errors == errors
    assert rig.loop.torque.armed and rig.loop.condition.state == "armed"


def test_an_answer_that_comes_late_never_passes_for_a_fresh_one(rigs: Made) -> None:
    """Each comes 10 ms late, one tick: then each question would be answered by the answer before."""
    rig = rigs(Standing)
    rig.connect()
    rig.seconds(0.2)
    last = rig.imu.time
    rig.virtual["main"].faults.delay(rig.loop.robot.period, id=rig.spec.id)
    rig.seconds(2.0)
    assert rig.imu.time <= last + 2 * rig.loop.robot.period
    assert rig.loop.robot.measured.heard.all()


@pytest.mark.parametrize("source", ["device", "filter"])
@pytest.mark.parametrize("zero", [0.0, 512.0])
def test_an_accelerometer_that_feels_nothing_at_all_is_no_reading(
    source: str, zero: float, rigs: Made
) -> None:
    """Registers that are 0, or say 0: asleep, rebooting, browned out. The robot may be falling."""
    rig = rigs(Standing)
    force = replace(rig.spec.acceleration, zero=zero)
    rig = rigs(Standing, acceleration=force, **({"quaternion": None} if source == "filter" else {}))
    rig.connect()
    rig.seconds(0.1)
    sensor = rig.virtual["main"].sensor
    last = rig.imu.time
    registers = []
    for felt in (np.zeros(3), np.full(3, -zero * force.lsb)):
        numbers = [np.zeros(3), felt, np.array([1.0, 0.0, 0.0, 0.0])][: len(sensor.cells)]
        sensor.measure = lambda numbers=numbers: numbers
        rig.seconds(0.2)
        registers.append(sensor.registers()[22:28])
    assert rig.imu.time <= last + 0.011
    assert registers[1] == bytes(6), "the chip's own zeros, too"
    assert not rig.loop.hardware.inertial.parked, "it answers: no fault of the line"


GYRO = RegistersSpec(16, "float32", 3, 4, 1.0, 0.0, "xyz")
FLOATS = ImuSpec("main", 200, "imu", None, 0.0, GYRO, replace(GYRO, address=28), None)


@given(st.binary(min_size=24, max_size=24) | st.lists(ODD, min_size=6, max_size=6).map(np.float32).map(bytes))
@example(bytes.fromhex("0100807f") * 6)
def test_any_bytes_are_a_reading_that_a_body_can_have_or_none(data: bytes) -> None:
    """No warning on the way (warnings are errors here), no number without bound told on as fresh. The example
    is a NaN that signals."""
    inertial = ImuPoller(FLOATS, (1.0, 0.0, 0.0, 0.0), 0)
    imu = inertial.make_reading([decoded(data, at, "<f4", 3) for at in (0, 12)], 1.0)
    if imu is not None:
        assert np.linalg.norm(imu.gyro) <= SPIN and 0.0 < np.linalg.norm(imu.acceleration) <= SHOCK


@pytest.mark.parametrize("wrong", ["zero", "long"])
def test_a_quaternion_that_is_none_is_no_reading(wrong: str, rigs: Made) -> None:
    rig = rigs(Standing)
    rig.connect()
    sensor = rig.virtual["main"].sensor
    last = rig.imu.time
    told = sensor.measure
    sensor.measure = lambda: [*told()[:2], np.zeros(4) if wrong == "zero" else 1.3 * told()[2]]
    rig.seconds(0.5)
    assert rig.imu.time <= last + 0.02


def test_torque_goes_before_the_imu(rigs: Made) -> None:
    """While a procedure that changes torque has the bus it is not asked."""
    rig = rigs(Standing, Mode.LIVE)
    rig.connect()
    rig.call(link.AcquireLease)
    asked = rig.loop.hardware.inertial.asked
    port = rig.loop.hardware.ports[0]
    rig.send(link.Arm)
    hurried = 0
    for _ in range(60):
        before = rig.loop.hardware.inertial.asked
        waits = port.hurried
        rig.ticks(1)
        hurried += waits and port.hurried and rig.loop.hardware.inertial.asked > before
    assert hurried == 0 and rig.loop.torque.armed and rig.loop.hardware.inertial.asked > asked


def test_an_imu_without_free_time_in_any_tick_is_polled_in_every_third(rigs: Made) -> None:
    """Answers that are late every time leave no room in any tick: it is heard all the same."""
    rig = rigs(Standing)
    rig.connect()
    inertial = rig.loop.hardware.inertial
    asked = []
    begin = inertial.begin
    inertial.begin = lambda port, now, end: begin(port, now, now)
    for _ in range(90):
        before = inertial.asked
        rig.ticks(1)
        asked.append(inertial.asked - before)
    assert asked == 30 * [0, 0, 1]
    assert rig.loop.robot.measured.time - rig.imu.time < 0.03


def test_a_lost_bus_leaves_the_last_reading_with_its_time_and_it_goes_on_after(rigs: Made) -> None:
    rig = rigs(Standing)
    rig.connect()
    rig.seconds(0.2)
    last = rig.imu.time
    rig.virtual["main"].faults.unplug()
    rig.seconds(0.5)
    assert rig.imu.time == last
    rig.virtual["main"].faults.replug()
    rig.seconds(2.0)
    assert rig.loop.robot.measured.time - rig.imu.time < 0.02


def test_a_robot_without_an_imu_reports_none(rigs: Made) -> None:
    rig = rigs(Rig, "h24", Mode.MIRROR)
    rig.connect()
    assert rig.loop.hardware.inertial is None and rig.loop.robot.measured.imu is None
    assert all(news.imu == b"" for news in rig.news if isinstance(news, Tick))
    assert sensor_of(rig.robot, "main", None) is None


def test_noise_and_bias_of_the_virtual_one_are_what_was_ordered(rigs: Made) -> None:
    rig = rigs(Standing, quaternion=None)
    rig.connect()
    rig.virtual["main"].sensor.err(gyro_noise=0.02, acceleration_noise=0.2, gyro_bias=0.03)
    gyro = []
    force = []
    for _ in range(400):
        rig.ticks(1)
        gyro.append(rig.imu.gyro)
        force.append(rig.imu.acceleration)
    assert np.mean(gyro, axis=0) == pytest.approx([0.03] * 3, abs=0.005)
    assert np.std(gyro, axis=0) == pytest.approx([0.02] * 3, rel=0.2)
    assert np.std(force, axis=0) == pytest.approx([0.2] * 3, rel=0.2)
    _, x, y, _ = rig.imu.quaternion.tolist()
    assert 2 * np.hypot(x, y) < radians(3.0)
    with pytest.raises(ValueError, match=r"noise is 0\.\.10"):
        rig.virtual["main"].sensor.err(gyro_noise=-1.0)
