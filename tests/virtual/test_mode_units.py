"""The operating modes as a host sees them on the bus, each by the e-manual chapter that states it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.virtual_serial_host import Host
from twind_drivers.dynamixel import packet

TICKS = 0.229 / 60 * 4096  # ticks/s per raw velocity
ARRIVED = 0x01
ONGOING = 0x02
ERRING = 0x08
RECTANGLE = 0x10
TRIANGLE = 0x20
TRAPEZOID = 0x30


def powered(mode: int, model: str = "XM430-W350", **settings: int) -> Host:
    host = Host([1], model=model, settings={"operating_mode": mode} | settings)
    if mode in (0, 16):  # a change of mode leaves them at their limits
        host.write(1, 102 if mode == 0 else 100, 0, 2)
    host.torque(1)
    return host


def test_velocity_mode_turns_endlessly_in_both_directions() -> None:
    """e-manual, "Operating Mode" 1; "Goal Velocity" (104); position limits count for nothing."""
    host = powered(1)
    for goal in (100, -150):
        assert host.write(1, 104, goal, 4) == 0
        host.wait(1.0)
        before = host.present(1)
        host.wait(10.0)
        assert host.read(1, 128, 4) == goal
        assert host.present(1) - before == pytest.approx(goal * TICKS * 10, rel=0.01)
        assert host.read(1, 122, 1) == 1
        assert host.read(1, 123, 1) == 0, "in position and following error are of the position modes"
    assert host.write(1, 104, 0, 4) == 0
    host.wait(0.5)
    assert (host.read(1, 128, 4), host.read(1, 122, 1)) == (0, 0)


def test_profile_acceleration_ramps_the_velocity_and_136_shows_the_ramp() -> None:
    """e-manual, "Profile Velocity" note: t1 = 64 x goal velocity / 108 ms; 112 is not used in this mode."""
    host = powered(1)
    host.write(1, 112, 3, 4)
    host.write(1, 108, 10, 4)
    begin = host.clock.now()
    host.write(1, 104, 100, 4)
    host.clock.sleep_until(begin + 0.32)
    assert host.read(1, 136, 4) == pytest.approx(50, abs=1)
    assert host.read(1, 128, 4) == pytest.approx(47, abs=3), "the speed loop lags 20 ms behind"
    assert host.read(1, 122, 1) == 1
    host.wait(0.4)
    assert (host.read(1, 136, 4), host.read(1, 123, 1) & ONGOING) == (100, 0)


def test_current_mode_drives_the_goal_current() -> None:
    """e-manual, "Operating Mode" 0: current only, regardless of speed and position."""
    host = powered(0)
    for goal in (12, -12):
        assert host.write(1, 102, goal, 2) == 0
        host.wait(1.0)
        assert host.read(1, 126, 2) == goal
        assert np.sign(host.read(1, 128, 4)) == np.sign(goal)
    host.servos.block(0, True)
    host.write(1, 102, 250, 2)
    host.wait(1.0)
    assert (host.read(1, 126, 2), host.read(1, 128, 4)) == (250, 0)


def test_pwm_mode_drives_the_goal_pwm_and_shows_its_sign() -> None:
    """e-manual, "Operating Mode" 16; present PWM is signed (facts: real logs misread -1 as 65535)."""
    host = powered(16)
    for goal in (442, -442):
        assert host.write(1, 100, goal, 2) == 0
        host.wait(1.0)
        assert host.read(1, 124, 2) == goal
        assert host.read(1, 128, 4) == pytest.approx(201 * goal / 885, abs=1)


@pytest.mark.parametrize(("mode", "goal", "shown"), [(0, (102, 12), 126), (16, (100, 442), 124)])
def test_current_and_pwm_have_no_profile(mode: int, goal: tuple[int, int], shown: int) -> None:
    """e-manual, "Profile Velocity", "Profile Acceleration": used in neither mode."""
    host = powered(mode)
    host.write(1, 112, 1, 4)
    host.write(1, 108, 1, 4)
    assert host.write(1, *goal, 2) == 0
    host.wait(0.3)
    assert host.read(1, shown, 2) == goal[1]
    assert host.read(1, 123, 1) == 0


def test_in_mode_5_the_goal_current_is_how_hard_it_pushes() -> None:
    """e-manual, "Current-based Position Control Mode"."""
    host = powered(5)
    host.write(1, 102, 100, 2)
    host.goal(1, 2500)
    host.wait(2.0)
    assert host.present(1) == pytest.approx(2500, abs=1)
    host.servos.block(0, True)
    host.goal(1, 4000)
    host.wait(0.5)
    assert host.read(1, 126, 2) == 100
    host.goal(1, -4000)
    host.wait(0.5)
    assert host.read(1, 126, 2) == -100


@pytest.mark.parametrize("mode", [0, 1, 16])
def test_a_tripped_watchdog_stops_every_mode_and_locks_its_goals(mode: int) -> None:
    """e-manual, "Bus Watchdog" (98), with its example in velocity mode: it stops as with a profile of 0."""
    host = powered(mode)
    host.write(1, 108, 1, 4)  # 6 s to the goal, and none of it on the stop
    address, size, goal = {0: (102, 2, 15), 1: (104, 4, 150), 16: (100, 2, 600)}[mode]
    host.write(1, address, goal, size)
    host.wait(7.0)
    host.write(1, 98, 5, 1)
    assert host.read(1, 128, 4) > 100
    host.wait(0.1001)
    assert host.servos.tripped[0]
    host.wait(2.0)
    assert (host.read(1, 98, 1), host.read(1, 64, 1)) == (-1, 1)
    assert [host.read(1, *at) for at in ((128, 4), (126, 2), (124, 2))] == [0, 0, 0]
    assert host.write(1, address, 1, size) == 4
    assert host.read(1, address, size) == goal
    assert host.write(1, 98, 0, 1) == 0
    host.wait(7.0)
    assert host.read(1, 128, 4) > 100, "cleared it resumes the goal register"


def test_a_watchdog_stop_in_the_middle_of_a_profile_holds_the_place() -> None:
    host = powered(4)
    host.write(1, 112, 50, 4)
    host.write(1, 108, 2, 4)
    host.write(1, 98, 5, 1)
    host.goal(1, 9000)
    for _ in range(25):
        host.wait(0.05)
        host.raw(packet.ping(1))
    moving = host.present(1)
    assert host.read(1, 123, 1) & ONGOING
    host.wait(0.1001)
    here = host.muscles.position[0]
    host.wait(3.0)
    assert abs(host.muscles.position[0] - here) <= 64
    assert moving < here < 8000
    assert host.read(1, 123, 1) & ONGOING == 0
    assert host.read(1, 136, 4) == 0


@pytest.mark.parametrize(
    ("velocity", "acceleration", "kind"),
    [(0, 0, 0), (0, 30, 0), (60, 0, RECTANGLE), (60, 20, TRAPEZOID), (400, 1, TRIANGLE)],
)
def test_moving_status_reports_the_profile_and_its_end(velocity: int, acceleration: int, kind: int) -> None:
    """e-manual, "Moving Status" (123), "Moving" (122): 1 as long as a profile runs."""
    host = powered(3)
    host.write(1, 112, velocity, 4)
    host.write(1, 108, acceleration, 4)
    host.goal(1, 2900)
    host.wait(0.06)
    status = host.read(1, 123, 1)
    assert status & 0x30 == kind
    assert bool(status & ONGOING) == (kind != 0)
    assert status & ARRIVED == 0
    assert host.read(1, 122, 1) == 1
    host.wait(6.0)
    assert host.read(1, 123, 1) & 0x0F == ARRIVED
    assert host.read(1, 122, 1) == 0


def test_trajectory_registers_show_where_the_profile_is() -> None:
    """e-manual, "Velocity Trajectory" (136), "Position Trajectory" (140)."""
    host = powered(3)
    host.write(1, 112, 50, 4)
    host.write(1, 108, 20, 4)
    begin = host.clock.now()
    host.goal(1, 3500)
    host.clock.sleep_until(begin + 0.8)
    ramp = 0.064 * 50 / 20
    assert host.read(1, 136, 4) == 50
    assert host.read(1, 140, 4) == pytest.approx(2048 + 50 * TICKS * (0.8 - ramp / 2), abs=3)
    assert host.present(1) == pytest.approx(host.read(1, 140, 4), abs=50)
    host.goal(1, 1000)
    host.wait(6.0)
    assert (host.read(1, 136, 4), host.read(1, 140, 4)) == (0, 1000)


def test_something_in_the_way_is_a_following_error() -> None:
    """e-manual, "Moving Status" bit 3; its bound of 100 ticks is assumed."""
    host = powered(3)
    host.write(1, 112, 30, 4)
    host.goal(1, 2600)
    host.wait(0.1)
    assert host.read(1, 123, 1) & ERRING == 0
    host.servos.block(0, True)
    host.wait(0.9)
    assert host.read(1, 123, 1) & ERRING


def test_a_time_based_profile_ends_on_time() -> None:
    """e-manual, "Drive Mode" bit 2: 112 is the whole time in ms, 108 the ramp."""
    host = powered(3, drive_mode=4)
    host.write(1, 112, 1000, 4)
    host.write(1, 108, 400, 4)
    for goal in (3000, 2900):
        begin = host.clock.now()
        host.goal(1, goal)
        host.clock.sleep_until(begin + 0.99)
        assert host.read(1, 123, 1) & ONGOING, "far or near"
        host.clock.sleep_until(begin + 1.01)
        assert host.read(1, 123, 1) & ONGOING == 0
        assert host.read(1, 140, 4) == goal


def test_an_xl430_shows_load_instead_of_current() -> None:
    """e-manual XL430, "Present Load" (126): 0.1 %, of the output; it has no current registers."""
    host = Host([1], model="XL430-W250")
    host.torque(1)
    host.servos.block(0, True)
    host.goal(1, 2068)
    host.wait(0.3)
    assert host.read(1, 126, 2) == pytest.approx(640 / 128 * 20 / 885 * 1000, abs=1)
    host.goal(1, 2028)
    host.wait(0.3)
    assert host.read(1, 126, 2) == pytest.approx(-640 / 128 * 20 / 885 * 1000, abs=1)


@pytest.mark.parametrize(("model", "sign"), [("XM430-W350", 1), ("XM540-W270", -1)])
def test_the_reverse_bit_inverts_velocity_current_and_pwm_on_the_540_only(model: str, sign: int) -> None:
    """e-manual, "Drive Mode" note: position everywhere; X540, XW540 and MX(2.0) the others too."""
    host = powered(1, model, drive_mode=1)
    before = float(host.muscles.position[0])
    shown = host.present(1)
    host.write(1, 104, 100, 4)
    host.wait(2.0)
    assert np.sign(host.muscles.position[0] - before) == sign
    assert np.sign(host.present(1) - shown) == -sign
    assert host.read(1, 128, 4) == 100
    assert np.sign([host.read(1, 126, 2), host.read(1, 124, 2)]).tolist() == [1, 1]


def test_torque_on_in_velocity_mode_resumes_the_goal_register() -> None:
    """As in the position modes the harsher case: the goal register keeps its value while torque is off."""
    host = powered(1)
    host.write(1, 104, 100, 4)
    host.wait(1.0)
    host.torque(1, False)
    host.wait(1.0)
    assert [host.read(1, *at) for at in ((128, 4), (126, 2), (124, 2), (104, 4))] == [0, 0, 0, 100]
    host.torque(1)
    host.wait(1.0)
    assert host.read(1, 128, 4) == 100


def test_a_p_series_servo_turns_at_its_own_scale() -> None:
    """e-manual PH54-200: 1,003,846 ticks a turn, 0.01 rev/min a count, 100 % of PWM are 2009 counts, 24 V."""
    host = Host([1], model="PH54-200-S500", settings={"operating_mode": 1})
    at = {key: (field.address, field.size) for key, field in host.servos.memory.tables[0].fields.items()}
    assert host.read(1, *at["present_input_voltage"]) == 240
    host.write(1, at["torque_enable"][0], 1, 1)
    assert host.write(1, at["goal_velocity"][0], 1000, 4) == 0
    host.wait(1.0)
    before = host.read(1, *at["present_position"])
    host.wait(6.0)
    assert host.read(1, *at["present_velocity"]) == 1000
    assert host.read(1, *at["present_position"]) - before == pytest.approx(1_003_846, rel=0.01)
    assert host.read(1, *at["hardware_error_status"]) == 0


@examples(60)
@given(
    st.sampled_from([0, 1, 3, 4, 5, 16]),
    st.integers(0, 13),
    st.lists(
        st.tuples(
            st.sampled_from([64, 84, 76, 78, 98, 100, 102, 104, 108, 112, 116]), st.integers(-3000, 9000)
        ),
        max_size=14,
    ),
)
def test_no_value_is_out_of_range_after_any_writes_in_any_mode(
    mode: int, drive_mode: int, writes: list[tuple[int, int]]
) -> None:
    sizes = {64: 1, 98: 1, 104: 4, 108: 4, 112: 4, 116: 4}
    host = Host([1], settings={"operating_mode": mode, "drive_mode": drive_mode & ~2})
    for address, value in writes:
        size = sizes.get(address, 2)
        value = value % 2 if address == 64 else value % 128 if address == 98 else value
        host.write(1, address, value, size)
        host.wait(0.07)
        motors = host.muscles
        assert np.isfinite([motors.position, motors.velocity, motors.current, motors.pwm]).all()
        assert abs(host.read(1, 124, 2)) <= 885
        assert abs(host.read(1, 126, 2)) <= 1193
        if mode == 5 and not host.servos.tripped[0]:
            assert abs(host.read(1, 126, 2)) <= abs(host.read(1, 102, 2))
        if not host.read(1, 64, 1):
            assert [host.read(1, *at) for at in ((128, 4), (126, 2), (124, 2))] == [0, 0, 0]
