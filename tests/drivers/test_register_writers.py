"""Writers of servos without a watchdog: what preparing sets, which registers are not theirs, what is undone.

The same claims for Feetech, for Protocol 1.0, and for XL-320 and PRO -R.
"""

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import pytest

from tests.support.dynamixel1_rig import QUICK, Dynamixel1Rig
from tests.support.feetech_rig import FeetechRig
from tests.support.unwatched_rig import UnwatchedRig
from twind_drivers.bus import (
    DeviceRefused,
    NoReply,
    PingRequest,
    ReadRequest,
    RebootRequest,
    RequestReply,
    WireRangeError,
    WriteRequest,
)
from twind_drivers.device_registers import RestartResult
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel1.dynamixel1_writer import Dynamixel1Writer
from twind_drivers.dynamixel1.virtual_dynamixel1_spec import Dynamixel1ServoSpec
from twind_drivers.dynamixel2_unwatched.unwatched_packets import PROTOCOL2, plain_transaction
from twind_drivers.dynamixel2_unwatched.unwatched_writer import Protocol2WriteCheck, UnwatchedWriter
from twind_drivers.feetech.feetech_writer import FeetechWriter
from twind_drivers.feetech.virtual_feetech_spec import FeetechServoSpec
from twind_drivers.half_duplex import checksum_packet
from twind_drivers.half_duplex.register_write_check import RegisterWriteCheck

COMMON = ("torque_enable", "goal_position", "id", "baud_rate", "status_return_level")


def feetech(model: str = "STS3215", **settings: int) -> FeetechRig:
    return FeetechRig([FeetechServoSpec(id, model, settings) for id in (1, 2)])


def mx(model: str = "MX-28(1.0)", **settings: int) -> Dynamixel1Rig:
    return Dynamixel1Rig([Dynamixel1ServoSpec(id, model, QUICK | settings) for id in (1, 2)])


def xl(model: str = "XL-320", **settings: int) -> UnwatchedRig:
    return UnwatchedRig([model] * 2, settings)


def pro(**settings: int) -> UnwatchedRig:
    return xl("H42-20-S300-R", **settings)


def hls() -> FeetechRig:
    return feetech("HLS3955")


def smbl() -> FeetechRig:
    return feetech("SM8512BL")


def ax() -> Dynamixel1Rig:
    return mx("AX-12A")


def prepared(rig: Any) -> Any:
    """A rig whose servos are prepared and have goals; they stand where they are."""
    here = rig.positions()
    rig.beside(rig.writer.prepare(here))
    rig.beside(rig.writer.write_goals(here))
    return rig


# ------------------------------------------------------------------------------- registers of others


@pytest.mark.parametrize(
    ("make", "names"),
    [
        (feetech, (*COMMON, "goal_velocity", "goal_time", "lock", "operating_mode")),
        (hls, ("goal_torque",)),
        (mx, (*COMMON, "moving_speed", "lock")),
        (lambda: mx("MX-64(1.0)"), ("torque_control_mode", "goal_torque")),
        (xl, (*COMMON, "moving_speed", "control_mode")),
        (pro, ("goal_torque", "goal_velocity", "goal_acceleration")),
    ],
)
def test_registers_that_other_paths_own_are_written_there_alone(
    make: Callable[[], Any], names: tuple[str, ...]
) -> None:
    rig = make()
    rig.positions()
    for name in names:
        before = rig.sent()
        with pytest.raises(ValueError, match=f"{name} is not written here: [a-z]"):
            rig.perform(rig.writer.write(2, name, 1))
        assert rig.sent() == before


# ------------------------------------------------------------------------------- preparing


@pytest.mark.parametrize(
    ("make", "wanted"),
    [
        (feetech, {"goal_velocity": 6000, "acceleration": 0, "lock": 1}),
        (smbl, {"goal_velocity": 6000, "acceleration": 0}),
        (hls, {"goal_velocity": 120, "acceleration": 0}),
        (lambda: feetech("SCS0009"), {"goal_velocity": 0}),
        (mx, {"moving_speed": 0}),
        (ax, {"moving_speed": 0}),
        (xl, {"moving_speed": 0}),
        (pro, {"goal_velocity": 0, "goal_acceleration": 0}),
    ],
)
def test_preparing_lifts_the_limits_of_speed_and_sets_no_goal_without_torque(
    make: Callable[[], Any], wanted: dict[str, int]
) -> None:
    rig = make()
    here = rig.positions() + np.array([3, -4])
    for row in range(2):
        for name in wanted:
            rig.servos.put(row, name, 0 if name == "lock" else 7)
        rig.servos.put(row, "goal_position", int(here[row]) + 9)
    rig.beside(rig.writer.prepare(here))
    for row in range(2):
        assert {name: rig.servos.get(row, name) for name in wanted} == wanted
        assert rig.servos.get(row, "goal_position") == here[row] + 9, "it may switch torque on"
    with pytest.raises(DeviceRefused, match="it got no goal since it was prepared"):
        rig.beside(rig.writer.torque(True))
    rig.beside(rig.writer.write_goals(here))
    rig.beside(rig.writer.torque(True))
    rig.beside(rig.writer.prepare(here + 2))
    assert [rig.servos.get(row, "goal_position") for row in range(2)] == (here + 2).tolist()


@pytest.mark.parametrize(
    ("make", "kind", "wanted", "set_", "kept"),
    [
        (
            feetech,
            FeetechWriter,
            {"gains": [(20, 3, None), (None, None, None)]},
            {"position_p_gain": 20, "position_i_gain": 3},
            "position_d_gain",
        ),
        (
            mx,
            Dynamixel1Writer,
            {"gains": [{"position_p_gain": 20, "position_i_gain": 3}, {}]},
            {"position_p_gain": 20, "position_i_gain": 3},
            "position_d_gain",
        ),
        (
            ax,
            Dynamixel1Writer,
            {"gains": [{"cw_compliance_slope": 20}, {}]},
            {"cw_compliance_slope": 20},
            "ccw_compliance_slope",
        ),
        (
            xl,
            UnwatchedWriter,
            {"gains": [{"position_p_gain": 20, "position_i_gain": 3}, {}]},
            {"position_p_gain": 20, "position_i_gain": 3},
            "position_d_gain",
        ),
    ],
)
def test_gains_are_those_of_the_robot_file_and_else_the_servos_own(
    make: Callable[[], Any], kind: Any, wanted: dict[str, Any], set_: dict[str, int], kept: str
) -> None:
    rig = make()
    own = {name: rig.servos.get(1, name) for name in (*set_, kept)}
    assert all(own[name] != value for name, value in set_.items())
    rig.writer = kind(rig.reader, lower=rig.lower, upper=rig.upper, **wanted)
    prepared(rig)
    assert {name: rig.servos.get(0, name) for name in own} == own | set_
    assert {name: rig.servos.get(1, name) for name in own} == own


@pytest.mark.parametrize(
    ("make", "kind", "first"),
    [
        (lambda: feetech(max_torque=900), FeetechWriter, [500, None]),
        (lambda: mx(max_torque=900), Dynamixel1Writer, [500, 1023]),
    ],
)
def test_the_full_torque_is_that_of_the_robot_file_but_never_more_than_the_servos_own(
    make: Callable[[], Any], kind: Any, first: list[int | None]
) -> None:
    rig = make()
    for limits, full in ((first, [500, 900]), ([950, 200], [900, 200])):
        rig.beside(rig.writer.torque(False))
        rig.writer = kind(rig.reader, lower=rig.lower, upper=rig.upper, torque_limits=limits)
        prepared(rig)
        assert [rig.servos.get(row, "torque_limit") <= 300 for row in range(2)] == [True] * 2
        rig.beside(rig.writer.torque(True))
        assert [rig.servos.get(row, "torque_limit") for row in range(2)] == full


@pytest.mark.parametrize(
    ("model", "own", "low", "full"),
    [("XL-320", 800, [240, 79], [800, 266]), ("H42-20-S300-R", 600, [180, 60], [600, 200])],
)
def test_the_full_torque_of_a_robot_file_is_a_share_of_1023(
    model: str, own: int, low: list[int], full: list[int]
) -> None:
    most = "max_torque" if model == "XL-320" else "torque_limit"
    limit = "torque_limit" if model == "XL-320" else "goal_torque"
    rig = xl(model, **{most: own})
    rig.writer = UnwatchedWriter(rig.reader, lower=rig.lower, upper=rig.upper, torque_limits=[1023, 341])
    prepared(rig)
    assert [rig.servos.get(row, limit) for row in range(2)] == low
    rig.beside(rig.writer.torque(True))
    assert [rig.servos.get(row, limit) for row in range(2)] == full


@pytest.mark.parametrize(
    ("make", "limit"),
    [
        (lambda: mx(max_torque=2), "torque_limit"),
        (lambda: xl(max_torque=2), "torque_limit"),
        (lambda: pro(torque_limit=2), "goal_torque"),
    ],
)
def test_a_low_limit_is_never_0_which_would_mean_another_thing(make: Callable[[], Any], limit: str) -> None:
    assert prepared(make()).servos.get(0, limit) == 1


def test_an_mx_that_regulates_its_torque_is_not_driven() -> None:
    rig = mx("MX-64(1.0)")
    here = rig.positions()
    rig.servos.put(1, "torque_control_mode", 1)
    with pytest.raises(DeviceRefused, match=r"id 2: arming: .*torque control"):
        rig.beside(rig.writer.prepare(here))


@pytest.mark.parametrize(("share", "full"), [(1023, 1023), (512, 512), (1, 1), (0, 1)])
def test_a_share_of_the_full_torque_of_an_xl_320_is_at_least_1(share: int, full: int) -> None:
    rig = xl()
    rig.writer = UnwatchedWriter(rig.reader, lower=rig.lower, upper=rig.upper, torque_limits=[share, share])
    prepared(rig)
    rig.beside(rig.writer.torque(True))
    assert rig.servos.get(0, "torque_limit") == full


def test_a_torque_limit_of_a_feetech_servo_is_at_most_1000() -> None:
    rig = prepared(feetech(max_torque=1020))
    rig.beside(rig.writer.torque(True))
    assert rig.servos.get(0, "torque_limit") == 1000


def test_a_servo_that_has_torque_keeps_its_full_limit_while_it_is_prepared() -> None:
    """A low one, even for a moment, would let it sag."""
    for make in (feetech, mx, xl):
        rig = make()
        here = rig.arm()
        lowest = 10_000
        script = rig.writer.prepare(here)
        order = next(script)
        while True:
            reply = rig.transact(order)
            lowest = min(lowest, rig.servos.get(0, "torque_limit"))
            try:
                order = script.send(reply)
            except StopIteration:
                break
        assert lowest == rig.servos.get(0, "torque_limit") >= 1000
        assert rig.energised().all()


@pytest.mark.parametrize("make", [mx, xl])
def test_a_servo_with_torque_that_its_alarm_has_taken_begins_limp(make: Callable[[], Any]) -> None:
    """Its switch reads on and its limit 0: a new limit alone would drive it at full stiffness."""
    rig = make()
    here = rig.positions()
    rig.servos.put(0, "torque_enable", 1)
    rig.servos.put(0, "torque_limit", 0)
    rig.beside(rig.writer.prepare(here))
    assert rig.energised().tolist() == [False, False]
    assert rig.servos.get(0, "torque_limit") == 306


def test_a_pro_r_with_torque_and_without_a_limit_is_held() -> None:
    """Goal torque 0 means no limit there."""
    rig = pro()
    here = rig.positions()
    for row in range(2):
        rig.servos.put(row, "torque_enable", 1)
        rig.servos.put(row, "goal_torque", 0)
    rig.beside(rig.writer.prepare(here))
    assert rig.energised().tolist() == [True, True]


# ------------------------------------------------------------------------------- damping


@pytest.mark.parametrize(
    ("make", "wanted"),
    [
        (feetech, {"position_p_gain": 4, "position_i_gain": 0, "position_d_gain": 30}),
        (mx, {"position_p_gain": 4, "position_i_gain": 0, "position_d_gain": 30}),
        (ax, {"cw_compliance_slope": 128, "ccw_compliance_slope": 200}),
        (xl, {"position_p_gain": 4, "position_i_gain": 0, "position_d_gain": 30}),
    ],
)
def test_damping_takes_away_stiffness_and_integral_and_keeps_what_brakes(
    make: Callable[[], Any], wanted: dict[str, int]
) -> None:
    rig = make()
    rig.positions()
    before = {
        "position_p_gain": 32,
        "position_i_gain": 5,
        "position_d_gain": 30,
        "cw_compliance_slope": 32,
        "ccw_compliance_slope": 200,
    }
    for name in wanted:
        rig.servos.put(0, name, before[name])
    rig.arm()
    assert rig.beside(rig.writer.damp()) == ()
    assert {name: rig.servos.get(0, name) for name in wanted} == wanted


# ------------------------------------------------------------------------------- EEPROM and restarts


@pytest.mark.parametrize(
    ("make", "name", "address"),
    [(feetech, "return_delay_time", 7), (mx, "return_delay_time", 5), (xl, "return_delay_time", 5)],
)
def test_eeprom_is_closed_again_after_a_write_that_failed(
    make: Callable[[], Any], name: str, address: int
) -> None:
    rig = make()
    rig.positions()
    rig.servos.write = lambda *_: 0  # it ignores what is written
    with pytest.raises(DeviceRefused, match="reads"):
        rig.beside(rig.writer.write(2, name, 7))
    with pytest.raises(WireRangeError, match="EEPROM"):
        rig.writer.begin(WriteRequest({2: b"\7"}, address), rig.clock.now())


@pytest.mark.parametrize("make", [feetech, xl, pro])
def test_a_servo_that_was_restarted_is_prepared_anew_before_torque(make: Callable[[], Any]) -> None:
    rig = make()
    here = rig.arm()
    with pytest.raises(DeviceRefused, match="its torque is on"):
        rig.beside(rig.writer.reboot(2))
    with pytest.raises(KeyError):
        rig.beside(rig.writer.reboot(9))
    rig.beside(rig.writer.torque(False))
    assert rig.beside(rig.writer.reboot(2)) == RestartResult()
    with pytest.raises(DeviceRefused, match="id 2: torque: it is not prepared"):
        rig.beside(rig.writer.torque(True))
    rig.ticks(60, here)
    prepared(rig)
    rig.beside(rig.writer.torque(True))
    assert rig.energised().all()


def restarted(rig: Any, script: Any, *, on: bool = False, lost: int = 0) -> None:
    """Run the restart of servo 2 without a cyclic reading beside it; the first `lost` orders do not arrive.

    `on`: it comes back with torque.
    """
    order = next(script)
    with suppress(StopIteration):
        while True:
            if isinstance(order, RebootRequest) and lost > 0:
                lost -= 1
                reply = RequestReply({}, {}, 0.001, 0)
            else:
                reply = rig.transact(order)
            rig.clock.sleep_until(rig.clock.now() + 0.01)
            if on and isinstance(order, PingRequest) and 2 in reply.data:
                rig.servos.put(1, "torque_enable", 1)
            order = script.send(reply)


def shut_down(make: Callable[[], Any]) -> Any:
    """A rig whose second servo has shut down by an error, although its switch reads on."""
    rig = make()
    rig.here = rig.arm()
    rig.faults.damage(2, 0x01 if make is xl else 0x20)
    rig.servos.put(1, "torque_enable", 1)
    return rig


@pytest.mark.parametrize("make", [feetech, xl, pro])
def test_an_error_alone_is_no_reason_to_restart_a_servo_whose_torque_reads_on(
    make: Callable[[], Any],
) -> None:
    rig = shut_down(make)
    with pytest.raises(DeviceRefused, match="its torque is on"):
        rig.perform(rig.writer.reboot(2))


@pytest.mark.parametrize("make", [feetech, xl, pro])
def test_a_servo_that_has_torque_and_no_error_is_not_restarted_as_one_that_has_shut_down(
    make: Callable[[], Any],
) -> None:
    rig = make()
    rig.arm()
    with pytest.raises(DeviceRefused, match="its torque is on"):
        rig.perform(rig.writer.reboot(2, shut_down=True))


@pytest.mark.parametrize("make", [feetech, xl])  # a PRO that shuts down reads torque off
def test_an_order_to_restart_that_was_lost_goes_again_and_two_are_no_restart(make: Callable[[], Any]) -> None:
    rig = shut_down(make)
    with pytest.raises(NoReply, match="reboot"):
        restarted(rig, rig.writer.reboot(2, shut_down=True), lost=2)
    assert rig.servos.get(1, "torque_enable") == 1
    restarted(rig, rig.writer.reboot(2, shut_down=True), lost=1)
    assert rig.servos.get(1, "torque_enable") == 0


@pytest.mark.parametrize("make", [feetech, xl, pro])
def test_a_restarted_servo_gets_no_goal_until_it_is_prepared(make: Callable[[], Any]) -> None:
    rig = shut_down(make)
    restarted(rig, rig.writer.reboot(2, shut_down=True))
    assert not rig.energised()[1]
    rig.servos.put(1, "torque_enable", 1)
    rig.ticks(60, rig.here)
    goal = rig.servos.get(1, "goal_position")
    rig.ticks(10, rig.here + 40)
    assert rig.servos.get(1, "goal_position") == goal
    assert rig.servos.get(0, "goal_position") == rig.here[0] + 40


@pytest.mark.parametrize("make", [feetech, xl, pro])
def test_torque_that_a_restart_switches_on_is_off_again(make: Callable[[], Any]) -> None:
    rig = make()
    rig.positions()
    restarted(rig, rig.writer.reboot(2), on=True)
    assert rig.energised().tolist() == [False, False]


def test_protocol_1_has_no_restart_of_any_servo() -> None:
    rig = mx()
    rig.positions()
    with pytest.raises(KeyError):
        rig.beside(rig.writer.reboot(9))


@pytest.mark.parametrize("make", [mx, xl])
def test_a_number_of_turns_is_no_shape_of_goals(make: Callable[[], Any]) -> None:
    rig = make()
    for wrong in (np.array([1, 2, 3]), np.array([[1, 2]]), np.array([1.0, 2.0])):
        with pytest.raises(ValueError, match="2 whole ticks needed"):
            rig.writer.goals(wrong)


@pytest.mark.parametrize("make", [feetech, mx, xl])
def test_new_bounds_drop_the_goals_that_wait(make: Callable[[], Any]) -> None:
    rig = make()
    here = rig.arm()
    rig.writer.goals(here)
    assert rig.reader.line.goals
    rig.writer.set_goal_limits(rig.lower, rig.upper)
    assert not rig.reader.line.goals


@pytest.mark.parametrize("make", [feetech, mx, xl])
def test_preparing_names_a_silent_servo_after_the_others_are_prepared(make: Callable[[], Any]) -> None:
    rig = make()
    here = rig.positions()
    rig.faults.silence(2)
    with pytest.raises(NoReply) as silent:
        rig.beside(rig.writer.prepare(here))
    assert silent.value.ids == (2,)
    rig.faults.silence(2, on=False)
    rig.beside(rig.writer.write_goals(here))
    with pytest.raises(DeviceRefused, match="not prepared") as refused:
        rig.beside(rig.writer.torque(True))
    assert refused.value.id == 2


@pytest.mark.parametrize("make", [feetech, mx])
def test_the_full_torque_limit_is_read_back_at_the_end(make: Callable[[], Any]) -> None:
    rig = prepared(make())
    limit = rig.reader.table(1)["torque_limit"]
    script, orders, reply = rig.writer.torque(True), [], None
    with suppress(StopIteration):
        while True:
            orders.append(script.send(reply))
            reply = rig.transact(orders[-1])
    assert isinstance(orders[-1], ReadRequest)
    assert limit.address in range(orders[-1].address, orders[-1].address + orders[-1].size)
    assert not any(isinstance(each, ReadRequest) for each in orders[-4:-1])


@pytest.mark.parametrize("code", [0x55, checksum_packet.READ])
def test_an_unknown_instruction_with_data_is_not_sent(code: int) -> None:
    rig = feetech()
    check = RegisterWriteCheck("arm", rig.reader.tables, {1: (0, 9), 2: (0, 9)}, b"")
    with pytest.raises(WireRangeError, match="address to id") as refused:
        check.judge(checksum_packet.instruction(1, code, b"\x2a\x01"))
    assert refused.value.value == checksum_packet.BROADCAST


@pytest.mark.parametrize("make", [feetech, mx, xl])
@pytest.mark.parametrize("side", [-1, 1])
def test_a_goal_may_lie_on_its_bound_and_no_count_beyond(make: Callable[[], Any], side: int) -> None:
    rig = prepared(make())
    lower, upper = rig.lower + 100, rig.upper - 200
    rig.writer.set_goal_limits(lower, upper)
    bound = lower if side < 0 else upper
    rig.writer.goals(bound)
    goals = np.array([int(lower[0]), int(bound[1]) + side])
    with pytest.raises(WireRangeError) as refused:
        rig.writer.goals(goals)
    found = refused.value
    assert (found.id, found.value, found.lower, found.upper) == (2, goals[1], lower[1], upper[1])


def test_stray_bytes_beside_a_packet_of_protocol_2_are_not_sent() -> None:
    off = packet.write(packet.BROADCAST, 24, b"\0")
    check = Protocol2WriteCheck("arm", xl().reader.tables, {1: (0, 9), 2: (0, 9)}, off)
    for data in (b"", b"\0", off + b"\0", b"\0" + off, off[:-1], off + off[:5]):
        with pytest.raises(WireRangeError, match="stray bytes") as refused:
            check.judge(data)
        assert (refused.value.value, refused.value.lower, refused.value.upper) == (len(data), 0, 0)
    check.judge(off)
    check.judge(off + packet.write(2, 30, b"\x09\0"))


def test_a_request_of_protocol_2_waits_for_the_return_delay_of_each_device() -> None:
    ping = plain_transaction(PingRequest(3))
    assert (ping.packet, ping.delays) == (packet.ping(3), 1)
    one = plain_transaction(ReadRequest((3,), 37, 6))
    assert (one.packet, one.delays) == (packet.read(3, 37, 6), 1)
    assert PROTOCOL2.request == len(one.packet)
    two = plain_transaction(ReadRequest((3, 4), 37, 6))
    assert (two.packet, two.delays) == (packet.sync_read((3, 4), 37, 6), 2)
