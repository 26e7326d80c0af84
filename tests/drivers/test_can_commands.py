"""Commands to CAN actuators one by one: what they hold, how often they are sent, and what is refused."""

from typing import Any

import numpy as np
import pytest

from tests.support.can_driver_rig import CanRig
from twind_drivers.bus import DeviceRefused, NoReply, WireRangeError
from twind_drivers.can.can_writer import CanWriter

DM = ("DM4310",) * 3


def prepared(rig: CanRig) -> CanRig:
    rig.here = rig.positions()  # type: ignore[attr-defined]
    rig.beside(rig.writer.prepare(rig.here))  # type: ignore[attr-defined]
    return rig


def written(**more: Any) -> CanWriter:
    """A writer of three actuators of the reader's own."""
    rig = CanRig(DM)
    usual: dict[str, Any] = {"lower": rig.lower, "upper": rig.upper}
    usual |= {"kp": np.full(3, 40.0), "kd": np.full(3, 1.0)}
    return CanWriter(rig.reader, **(usual | more))


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"kp": np.array([40.0, 500.1, 40.0])}, r"arm: id 2: kp 500\.1 is outside 0\.\.500\.0"),
        ({"kp": np.array([40.0, 40.0, -0.1])}, r"arm: id 3: kp -0\.1 is outside 0\.\.500\.0"),
        ({"kd": np.array([5.1, 6.0, 1.0])}, r"arm: id 1: kd 5\.1 is outside 0\.\.5\.0"),
        ({"kd": np.array([1.0, np.nan, 1.0])}, r"arm: id 2: kd nan is outside 0\.\.5\.0"),
        ({"kp": np.full(2, 1.0)}, r"\(2,\) values for 3 actuators"),
        ({"kd": np.full(4, 1.0)}, r"\(4,\) values for 3 actuators"),
        ({"lower": np.array([0, 9, 9]), "upper": np.array([0, 8, 7])}, r"arm: id 2: bounds 9\.\.8"),
        ({"upper": np.zeros(2, np.int64)}, r"\(2,\) values for 3 actuators"),
        ({"torque_limits": np.zeros(2)}, r"\(2,\) limits, \(3,\) policies for 3 actuators"),
        ({"watchdog": [True]}, r"\(3,\) limits, \(1,\) policies for 3 actuators"),
    ],
)
def test_a_writer_that_could_not_command_does_not_come_into_being(more: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        written(**more)


def test_gains_may_lie_on_the_ends_of_their_fields() -> None:
    written(kp=np.array([0.0, 500.0, 1.0]), kd=np.array([0.0, 5.0, 1.0]))


def test_the_bounds_of_an_actuator_may_meet() -> None:
    written(lower=np.array([5, -9, 0]), upper=np.array([5, 9, 0])).goals(np.array([5, 0, 0]))


def test_registers_that_other_paths_own_are_written_there_alone() -> None:
    rig = CanRig(("DM4310", "RS01"))
    rig.positions()
    for id, names in (
        (1, ("timeout", "mode", "master_id", "esc_id", "can_rate")),
        (2, ("timeout", "run_mode", "torque_limit")),
    ):
        for name in names:
            before = rig.sent()
            with pytest.raises(ValueError, match=f"{name} is not written here: [a-z]"):
                rig.perform(rig.writer.write(id, name, 1))
            assert rig.sent() == before


@pytest.mark.parametrize(("rate", "seconds"), [(100.0, 0.5), (50.0, 0.5), (10.0, 1.0)])
def test_a_hold_without_goals_lasts_half_a_second_or_ten_cycles(rate: float, seconds: float) -> None:
    """For ever would feed the watchdogs of a writer that is gone."""
    rig = CanRig(DM, rate_hz=rate)
    next(rig.writer.write_goals(rig.positions()))
    line = rig.reader.line
    assert line.goals is not None and line.goals.kept
    assert line.goals.until - line.sent == pytest.approx(seconds)


@pytest.mark.parametrize(("kd", "soft"), [(1.0, 2.0), (2.5, 5.0), (4.0, 5.0)])
def test_a_soft_actuator_is_damped_twice_as_much_as_its_field_holds(kd: float, soft: float) -> None:
    rig = CanRig(DM)
    rig.writer = CanWriter(
        rig.reader, lower=rig.lower, upper=rig.upper, kp=np.full(3, 40.0), kd=np.full(3, kd)
    )
    here = rig.arm()
    assert rig.beside(rig.writer.damp()) == ()
    rig.tick(here)
    # the command frame in bits: position 16, velocity 12, kp 12, kd 12, torque 12
    [found] = {
        (int(word) >> 24 & 0xFFF, int(word) >> 12 & 0xFFF)
        for frames in rig.channel.trains[-2:]
        for word, id in zip(frames["data"].copy().view(">u8")[:, 0], frames["id"], strict=True)
        if int(id) in (1, 2, 3)
    }
    assert found[0] == 0
    assert found[1] == pytest.approx(soft / 5.0 * 4095, abs=1.0)


@pytest.mark.parametrize("side", [-1, 1])
def test_a_goal_may_lie_on_its_bound_and_no_count_beyond(side: int) -> None:
    rig = CanRig(DM)
    lower, upper = np.full(3, -500), np.full(3, 700)
    rig.writer.set_goal_limits(lower, upper)
    bound = lower if side < 0 else upper
    rig.writer.goals(bound)
    assert rig.reader.line.goals is not None
    with pytest.raises(WireRangeError) as refused:
        rig.writer.goals(np.array([0, int(bound[1]) + side, 0]))
    found = refused.value
    assert (found.id, found.value, found.lower, found.upper) == (2, bound[1] + side, -500.0, 700.0)
    assert rig.reader.line.goals is None, "nothing is pending"
    with pytest.raises(ValueError, match=r"\(2,\) goals for 3 actuators"):
        rig.writer.goals(np.zeros(2, np.int64))


def test_goals_of_earlier_bounds_are_never_sent() -> None:
    for drop in (
        lambda writer: writer.clear(),
        lambda writer: writer.cut(),
        lambda writer: writer.set_goal_limits(np.full(3, -9), np.full(3, 9)),
    ):
        rig = CanRig(DM)
        rig.writer.goals(np.zeros(3, np.int64))
        drop(rig.writer)
        assert rig.reader.line.goals is None


def test_a_cut_is_two_orders_to_each_actuator() -> None:
    rig = CanRig(DM)
    rig.arm()
    rig.writer.cut()
    before = rig.sent()
    rig.tick()
    first = rig.channel.trains[before]
    off = [int(frame["id"]) for frame in first if frame["data"].tobytes() == b"\xff" * 7 + b"\xfd"]
    assert sorted(off) == [1, 1, 2, 2, 3, 3]
    assert not rig.energised().any()


def test_goals_that_an_actuator_does_not_acknowledge_are_sent_three_times() -> None:
    rig = prepared(CanRig(DM))
    rig.faults.silence(2)
    script = rig.writer.write_goals(rig.here)  # type: ignore[attr-defined]
    orders = [next(script)]
    for _ in range(2):
        orders.append(script.send(rig.transact(orders[-1])))
    with pytest.raises(NoReply) as caught:
        script.send(rig.transact(orders[-1]))
    assert caught.value.ids == (2,)
    assert [sorted(order.writes[0].data) for order in orders] == [[1, 2, 3], [2], [2]]


def test_the_goals_that_were_sent_are_read_and_none_before() -> None:
    rig = CanRig(DM)
    with pytest.raises(NoReply, match="goal: none was sent"):
        rig.perform(rig.writer.read_goals())
    here = rig.arm()
    rig.tick(here + np.array([3, -4, 5]))
    assert rig.perform(rig.writer.read_goals()).tolist() == (here + np.array([3, -4, 5])).tolist()


@pytest.mark.parametrize("model", ["DM4310", "AK80-9", "RS01"])
def test_an_actuator_without_a_restart_is_not_restarted(model: str) -> None:
    rig = CanRig((model,))
    rig.positions()
    before = rig.sent()
    with pytest.raises(DeviceRefused, match="switch its power off and on"):
        rig.perform(rig.writer.reboot(1))
    assert rig.sent() == before


def test_an_axis_with_torque_is_restarted_only_if_it_has_shut_down() -> None:
    rig = CanRig(("ODrive",))
    here = rig.arm()
    rig.ticks(20, here)
    with pytest.raises(DeviceRefused, match="its torque is on"):
        rig.beside(rig.writer.reboot(1))
    rig.beside(rig.writer.reboot(1, shut_down=True))
    assert not rig.energised().any()
