"""Gains that the robot file leaves to the servo: kept over damping, never taken from an earlier arming."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.support.servos_without_watchdog import MAKERS, contents, feetech, ignores_writes, mx, run, xl
from twind_drivers.bus import DeviceRefused, GroupWriteBatch, NoReply, WriteRequest

GAIN = "position_p_gain"


def gains(rig: Any) -> list[int]:
    return contents(rig, GAIN)


@MAKERS
def test_a_damped_servo_has_its_gains_again_once_its_torque_is_off(make: Callable[[], Any]) -> None:
    """Else the writer of the next mode, port or reload takes the soft gains for the servo's own."""
    rig = make()
    rig.arm()
    own = gains(rig)
    assert rig.beside(rig.writer.damp()) == ()
    assert gains(rig) != own
    rig.beside(rig.writer.torque(False))
    assert gains(rig) == own


@MAKERS
def test_torque_is_off_also_where_a_damped_servo_does_not_take_its_gains_back(
    make: Callable[[], Any],
) -> None:
    rig = make()
    rig.arm()
    own = gains(rig)
    rig.beside(rig.writer.damp())
    write = rig.servos.write
    rig.servos.write = lambda row, address, data: (
        write(row, address, data) if address == rig.writer.TORQUE else 0
    )
    rig.beside(rig.writer.torque(False))
    assert not rig.energised().any()
    rig.servos.write = write
    rig.arm()
    assert gains(rig) == own


@MAKERS
def test_a_gain_that_was_written_after_an_arming_counts_in_the_next(make: Callable[[], Any]) -> None:
    rig = make()
    rig.arm()
    rig.beside(rig.writer.torque(False))
    rig.beside(rig.writer.write(2, GAIN, 17))
    rig.arm()
    assert gains(rig)[1] == 17


@MAKERS
def test_a_servo_that_lost_its_torque_between_two_dampings_has_its_gains_again_too(
    make: Callable[[], Any],
) -> None:
    rig = make()
    rig.arm()
    own = gains(rig)
    rig.beside(rig.writer.damp())
    rig.servos.put(1, "torque_enable", 0)
    rig.ticks(20)
    assert rig.beside(rig.writer.damp()) == ()
    rig.beside(rig.writer.torque(False))
    assert gains(rig) == own


@pytest.mark.parametrize("make", [mx, xl])
def test_gains_return_once_and_not_over_those_that_were_written_later(make: Callable[[], Any]) -> None:
    rig = make()
    here = rig.arm()
    rig.beside(rig.writer.damp())
    rig.beside(rig.writer.prepare(here))
    rig.beside(rig.writer.write(2, GAIN, 17))
    rig.beside(rig.writer.torque(False))
    assert gains(rig)[1] == 17, "they are its own since it was prepared"
    rig.arm()
    rig.beside(rig.writer.damp())
    rig.beside(rig.writer.torque(False))
    rig.beside(rig.writer.write(2, GAIN, 18))
    rig.arm()
    assert gains(rig)[1] == 18, "they are its own since its torque is off"


@MAKERS
def test_of_damped_servos_those_that_are_not_prepared_stay_soft_until_torque_is_off(
    make: Callable[[], Any],
) -> None:
    rig = make()
    here = rig.arm()
    own = gains(rig)
    rig.beside(rig.writer.damp())
    soft = gains(rig)
    rig.beside(rig.writer.prepare(here, np.array([True, False])))
    rig.beside(rig.writer.write_goals(here))
    rig.beside(rig.writer.torque(True))
    assert gains(rig) == [own[0], soft[1]]
    rig.beside(rig.writer.torque(False))
    assert gains(rig) == own


@MAKERS
@pytest.mark.parametrize("silent", [True, False])
def test_gains_return_where_torque_is_off_although_another_servo_does_not_confirm_it(
    make: Callable[[], Any], silent: bool
) -> None:
    """Else a servo that stays dead leaves soft gains in all others, and the next writer takes them over."""
    rig = make()
    rig.arm()
    own = gains(rig)
    rig.beside(rig.writer.damp())
    soft = gains(rig)
    if silent:
        rig.faults.silence(2)
    else:
        ignores_writes(rig, 1, of="torque_enable")
    for _ in range(2):
        with pytest.raises(NoReply if silent else DeviceRefused, match="2"):
            rig.beside(rig.writer.torque(False))
        assert gains(rig) == [own[0], soft[1]]
    rig.beside(rig.writer.write(1, GAIN, 17))
    with pytest.raises(NoReply if silent else DeviceRefused):
        rig.beside(rig.writer.torque(False))
    assert gains(rig) == [17, soft[1]]


# ------------------------------------------------------------------------------- whom damping reaches


def stiffness(rig: Any) -> list[tuple[int, int]]:
    return list(zip(contents(rig, "torque_limit"), gains(rig), strict=True))


@MAKERS
def test_damping_leaves_servos_without_torque_alone_and_names_those_it_does_not_know(
    make: Callable[[int], Any],
) -> None:
    """The first is limp, the third was never prepared and has torque by another writer."""
    rig = make(3)
    here = rig.positions()
    for among in ([True, True, False], [False, True, False]):
        rig.beside(rig.writer.prepare(here, np.array(among)))
        rig.beside(rig.writer.write_goals(here))
    rig.beside(rig.writer.torque(True))
    rig.servos.put(2, "torque_enable", 1)
    rig.ticks(20)
    assert rig.registers.torque.tolist() == [0, 1, 1]
    before = stiffness(rig)
    assert rig.beside(rig.writer.damp()) == (3,)
    after = stiffness(rig)
    assert (after[0], after[2]) == (before[0], before[2])
    assert after[1] < before[1]
    rig.servos.put(2, "torque_enable", 0)
    rig.ticks(20)
    assert rig.beside(rig.writer.damp()) == (), "who has no torque need not be soft"


@MAKERS
def test_a_servo_whose_torque_is_not_known_is_damped(make: Callable[[], Any]) -> None:
    rig = make()
    rig.arm()
    before = stiffness(rig)
    rig.registers.expire_torque(1)
    assert rig.perform(rig.writer.damp()) == ()
    assert all(soft < stiff for soft, stiff in zip(stiffness(rig), before, strict=True))


@MAKERS
def test_damping_names_silent_servos_and_those_that_keep_their_stiffness_and_damps_the_others(
    make: Callable[[int], Any],
) -> None:
    rig = make(4)
    rig.arm()
    before = stiffness(rig)
    ignores_writes(rig, 1)
    rig.faults.silence(4)
    rig.faults.silence(1)
    assert rig.beside(rig.writer.damp()) == (1, 2, 4)
    after = stiffness(rig)
    assert after[2] < before[2]
    assert [after[row] for row in (0, 1, 3)] == [before[row] for row in (0, 1, 3)]
    assert rig.energised().all()


# ------------------------------------------------------------------------------- what restoring must not do


@MAKERS
def test_a_servo_that_does_not_confirm_torque_off_gets_the_order_again_with_the_gains_of_the_others(
    make: Callable[[], Any],
) -> None:
    """They take several transactions, and the caller repeats the order only after them."""
    rig = make()
    rig.arm()
    rig.beside(rig.writer.damp())
    ignores_writes(rig, 1, of="torque_enable")
    sent: list[Any] = []
    with pytest.raises(DeviceRefused):
        run(rig, rig.writer.torque(False), sent.append)
    batches = [order.writes for order in sent if isinstance(order, GroupWriteBatch)]
    off = WriteRequest({1: b"\0", 2: b"\0"}, rig.writer.TORQUE)
    assert [writes[:3] for writes in batches] == [(off,) * 3] * 2
    assert len(batches[1]) > 3


@pytest.mark.parametrize("damped", [False, True])
def test_no_gain_reaches_the_eprom_of_a_feetech_servo_whose_lock_is_open(damped: bool) -> None:
    rig = feetech()
    rig.arm()
    rig.servos.eprom[1][rig.reader.table(2)[GAIN].address] = 31
    kept = [bytes(each) for each in rig.servos.eprom]
    if damped:
        rig.beside(rig.writer.damp())
    rig.servos.put(1, "lock", 0)
    rig.beside(rig.writer.torque(False) if damped else rig.writer.damp())
    assert [bytes(each) for each in rig.servos.eprom] == kept
    assert gains(rig)[1] == (32 if damped else 4)


@pytest.mark.parametrize("make", [mx, xl])
def test_a_gain_written_to_a_damped_servo_is_the_one_it_has_after_torque_off(make: Callable[[], Any]) -> None:
    rig = make()
    rig.arm()
    rig.beside(rig.writer.damp())
    rig.beside(rig.writer.write(2, GAIN, 17))
    rig.beside(rig.writer.torque(False))
    assert gains(rig)[1] == 17


@pytest.mark.parametrize("make", [feetech, xl])
def test_a_damped_servo_that_was_restarted_keeps_what_is_written_to_it(make: Callable[[], Any]) -> None:
    rig = make()
    rig.arm()
    rig.beside(rig.writer.damp())
    rig.servos.put(1, "torque_enable", 0)
    rig.beside(rig.writer.reboot(2))
    rig.beside(rig.writer.write(2, GAIN, 17))
    rig.beside(rig.writer.torque(False))
    assert gains(rig)[1] == 17
