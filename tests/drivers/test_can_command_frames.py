"""Command frames of CAN actuators by their fields: position, speed, stiffness, damping, torque."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.can_driver_rig import CanRig
from twind_drivers.bus import NoReply, WireRangeError
from twind_drivers.can.can_units import COUNT
from twind_drivers.can.can_writer import CanWriter
from twind_drivers.can.cubemars_codec import CubeMarsCodec
from twind_drivers.can.damiao_codec import DamiaoCodec
from twind_drivers.ports.frame import Frames

DM = ("DM4310",) * 3
KP, KD = 40.0, 1.0  # of the rig's writer
MIDDLE, STILL = 0x7FFF, 0x7FF  # fields of position 0, and of speed or torque 0
STIFF, DAMPED, SOFT = 327, 819, 1638  # fields of 40 N·m/rad, of 1 and of 2 N·m·s/rad


def fields(frame: Any) -> tuple[int, ...]:
    """Position, speed, kp, kd, torque of an MIT frame, whole."""
    word = int.from_bytes(frame["data"].tobytes(), "big")
    return word >> 48, word >> 36 & 0xFFF, word >> 24 & 0xFFF, word >> 12 & 0xFFF, word & 0xFFF


def pending(rig: CanRig) -> list[tuple[int, ...]]:
    """Fields of the commands that wait for the next request."""
    assert rig.reader.line.goals is not None
    return [fields(frame) for frame in rig.reader.line.goals.frames]


def speeds(rig: CanRig, ticks: Sequence[int]) -> list[float]:
    """Speeds, rad/s, beside these goals."""
    rig.writer.goals(np.array(ticks))
    return [each[1] * 60.0 / 4095 - 30.0 for each in pending(rig)]


def place(field: int) -> float:
    """A position field in counts."""
    return (field * 25.0 / 65535 - 12.5) / COUNT


def about(*values: float) -> Any:
    return pytest.approx(values, abs=0.015)


# ------------------------------------------------------------------------------------- the five fields


def test_a_goal_is_its_position_with_the_gains_and_no_torque() -> None:
    rig = CanRig(DM)
    rig.writer.goals(np.array([300, -400, 0]))
    found = pending(rig)
    assert [each[1:] for each in found] == [(STILL, STIFF, DAMPED, STILL)] * 3
    assert [place(each[0]) for each in found] == pytest.approx([300, -400, 0], abs=1.0)


def test_a_hold_is_stiff_without_speed_for_all_that_are_not_barred() -> None:
    rig = CanRig(DM)
    rig.reader.cyclic.barred[1] = True
    next(rig.writer.write_goals(np.array([300, -400, 0])))
    found = pending(rig)
    assert [each[1:] for each in found] == [(STILL, STIFF, DAMPED, STILL)] * 2
    assert [place(each[0]) for each in found] == pytest.approx([300, 0], abs=1.0)
    assert rig.reader.line.goals.rows.tolist() == [True, False, True]


def test_goals_go_to_all_actuators_but_barred_ones() -> None:
    rig = CanRig(DM)
    rig.reader.cyclic.barred[1] = True
    rig.writer.goals(np.zeros(3, np.int64))
    assert rig.reader.line.goals.frames["id"].tolist() == [1, 3]
    assert rig.reader.line.goals.rows.tolist() == [True, False, True]


def soft_among_stiff() -> CanRig:
    """Softness was ordered; all but the second, which did not reply, were prepared anew."""
    rig = CanRig(DM)
    here = rig.arm()
    rig.ticks(5, here)
    rig.beside(rig.writer.damp())
    rig.faults.silence(2)
    with pytest.raises(NoReply):
        rig.beside(rig.writer.prepare(here))
    rig.faults.silence(2, False)
    rig.reader.cyclic.barred[:] = False
    rig.writer.goals(here)
    rig.read()
    rig.writer.goals(here + 100)
    return rig


def test_a_soft_actuator_among_stiff_ones_has_no_stiffness_no_speed_and_double_damping() -> None:
    found = pending(soft_among_stiff())
    assert found[1][1:] == (STILL, 0, SOFT, STILL)
    for row in (0, 2):
        assert found[row][1] > STILL + 100, "its step as a speed"
        assert found[row][2:] == (STIFF, DAMPED, STILL)
    assert found[0][0] == found[1][0] == found[2][0] > MIDDLE, "each has its position"


def test_actuators_are_enabled_with_commands_without_stiffness_and_with_double_damping() -> None:
    rig = CanRig(DM)
    here = rig.positions()
    rig.beside(rig.writer.prepare(here))
    rig.beside(rig.writer.write_goals(here))
    order = next(rig.writer.torque(True))
    assert [each[1:] for each in pending(rig)] == [(STILL, 0, SOFT, STILL)] * 3
    rig.channel.trains.clear()
    rig.transact(order)
    [sent] = rig.channel.trains
    assert [fields(frame)[1:] for frame in sent[3:]] == [(STILL, 0, SOFT, STILL)] * 3
    assert all(place(fields(frame)[0]) == pytest.approx(here[0], abs=1.0) for frame in sent[3:])


def test_the_gains_of_an_odrive_are_those_of_the_writer_until_it_is_damped() -> None:
    rig = CanRig(("ODrive",) * 2)
    here = rig.arm()

    def gains() -> set[tuple[float, float]]:
        """kp and kd from frames 1A and 1B."""
        frames = np.concatenate(rig.channel.trains)
        outer = [frame["data"][:4].copy().view("<f4")[0] for frame in frames if frame["id"] & 31 == 0x1A]
        inner = [frame["data"][:4].copy().view("<f4")[0] for frame in frames if frame["id"] & 31 == 0x1B]
        damping = [each / (2 * np.pi) for each in inner]
        return {(round(p * d, 3), round(d, 3)) for p, d in zip(outer, damping, strict=True)}

    assert gains() == {(KP, KD)}
    rig.channel.trains.clear()
    rig.beside(rig.writer.damp())
    rig.ticks(3, here)
    assert gains() == {(0.0, 2 * KD)}


@pytest.mark.parametrize(("lower", "field"), [(-500, MIDDLE), (600, 33370)])
def test_damping_before_any_position_is_known_commands_the_nearest_permitted_one_to_zero(
    lower: int, field: int
) -> None:
    rig = CanRig(DM)
    rig.writer.set_goal_limits(np.full(3, lower), np.full(3, 700))
    rig.transact(next(rig.writer.damp()))
    assert [fields(frame) for frame in rig.channel.trains[-1]] == [(field, STILL, 0, SOFT, STILL)] * 3


# ------------------------------------------------------------------------------------- the speed


def test_the_speed_is_the_step_from_the_last_goals_of_the_cycle_before() -> None:
    rig = CanRig(DM)
    step = COUNT * 100.0
    assert speeds(rig, [0, 0, 0]) == about(0.0, 0.0, 0.0)
    assert speeds(rig, [50, 50, 50]) == about(0.0, 0.0, 0.0), "in the same cycle it is another first goal"
    rig.read()
    assert speeds(rig, [60, 50, 30]) == about(10 * step, 0.0, -20 * step)
    assert speeds(rig, [70, 50, 30]) == about(20 * step, 0.0, -20 * step), "in the same cycle"
    rig.read()
    assert speeds(rig, [75, 50, 30]) == about(5 * step, 0.0, 0.0)


def test_goals_after_a_cycle_without_goals_or_after_new_bounds_have_no_speed() -> None:
    rig = CanRig(DM)
    speeds(rig, [0, 0, 0])
    rig.read()
    rig.read()
    assert speeds(rig, [60, 60, 60]) == about(0.0, 0.0, 0.0)
    rig.read()
    rig.writer.set_goal_limits(np.full(3, -100), np.full(3, 100))
    assert speeds(rig, [80, 80, 80]) == about(0.0, 0.0, 0.0)
    rig.read()
    speeds(rig, [80, 80, 80])
    rig.writer.set_goal_limits(np.full(3, -90), np.full(3, 90))
    assert speeds(rig, [85, 85, 85]) == about(0.0, 0.0, 0.0), "in the same cycle"


def test_refused_goals_are_no_step_to_the_next_ones() -> None:
    rig = CanRig(DM)
    speeds(rig, [0, 0, 0])
    rig.read()
    with pytest.raises(WireRangeError):
        rig.writer.goals(rig.upper + 1)
    assert speeds(rig, [10, 10, 10]) == about(*[10 * COUNT * 100.0] * 3)


def test_a_step_as_fast_as_the_field_has_its_speed_and_a_faster_one_none() -> None:
    rig = CanRig(DM)
    rig.actuators = [replace(each, velocity=40 * COUNT * 100.0) for each in rig.actuators]
    rig.open()
    rig.writer.goals(np.zeros(3, np.int64))
    rig.read()
    rig.writer.goals(np.array([40, 41, -40]))
    assert [each[1] for each in pending(rig)] == [0xFFF, STILL, 0]


# ------------------------------------------------------------------------------------- soft polls


def polls(rig: CanRig) -> list[Any]:
    rig.channel.trains.clear()
    rig.ticks(3)
    rows = rig.reader.fleet.commanded_rows
    return [frame for train in rig.channel.trains for frame in train[rows(train) >= 0]]


def test_only_actuators_that_answer_nothing_but_commands_are_polled_with_soft_ones() -> None:
    """Others may hold a load for another program."""
    rig = CanRig(("DM4310", "AK70-10", "RS01", "ODrive"))
    rig.ticks(110)
    assert {int(frame["id"]) for frame in polls(rig)} == {2}
    assert not any(rig.reader.fleet.commanded_rows(train).max(initial=-1) >= 0 for train in quiet(DM))


def quiet(models: Sequence[str]) -> list[Frames]:
    rig = CanRig(models)
    rig.ticks(110)
    return rig.channel.trains


@pytest.mark.parametrize(
    ("lower", "upper", "least", "most"),
    [(-500, 700, -0.6, 0.0), (600, 700, 599.0, 600.5), (-700, -600, -601.0, -599.5)],
)
def test_a_soft_poll_is_damped_and_at_the_nearest_permitted_place_to_zero(
    lower: int, upper: int, least: float, most: float
) -> None:
    rig = CanRig(("AK70-10", "AK70-10"))
    rig.writer.set_goal_limits(np.full(2, lower), np.full(2, upper))
    rig.ticks(110)
    found = [fields(frame) for frame in polls(rig)]
    assert found
    for each in found:
        assert each[1:] == (STILL, 0, SOFT, STILL)
        assert least <= place(each[0]) <= most


def test_an_actuator_that_answers_only_commands_is_polled_again_after_a_cut() -> None:
    rig = CanRig(("AK70-10", "AK70-10"))
    here = rig.arm()
    rig.ticks(110, here)
    rig.writer.cut()
    rig.ticks(5)
    assert not rig.energised().any()
    assert rig.tick().heard.all()
    assert {int(frame["id"]) for frame in polls(rig)} == {1, 2}


def test_after_a_failed_torque_on_the_actuator_without_torque_is_polled_and_one_that_holds_is_not() -> None:
    rig = CanRig(("AK70-10", "AK70-10"))
    here = rig.arm()
    rig.ticks(110, here)
    rig.faults.silence(2)
    rig.ticks(20, here)
    with pytest.raises(NoReply):
        rig.beside(rig.writer.torque(True))
    rig.faults.silence(2, False)
    rig.ticks(3)
    assert {int(frame["id"]) for frame in polls(rig)} == {2}


# ------------------------------------------------------------------------------------- codecs with a defect


def test_a_writer_whose_torque_off_would_go_to_another_id_does_not_come_into_being(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    honest = DamiaoCodec.encode_valueless_command

    def aside(self: DamiaoCodec, *order: Any) -> Frames:
        made = honest(self, *order)
        made["id"] += 100
        return made

    rig = CanRig(DM)
    gains = {"kp": np.full(3, KP), "kd": np.full(3, KD)}
    monkeypatch.setattr(DamiaoCodec, "encode_valueless_command", aside)
    with pytest.raises(WireRangeError, match="order to a frame id"):
        CanWriter(rig.reader, lower=rig.lower, upper=rig.upper, **gains)


@pytest.mark.parametrize(("codec", "models"), [(DamiaoCodec, DM), (CubeMarsCodec, ("AK70-10",) * 3)])
def test_a_command_that_does_not_decode_to_a_permitted_goal_is_not_sent(
    monkeypatch: pytest.MonkeyPatch, codec: type[DamiaoCodec | CubeMarsCodec], models: Sequence[str]
) -> None:
    honest = codec.command

    def aside(self: Any, position: Any, *more: Any) -> Frames:
        return honest(self, position + 900 * COUNT, *more)

    rig = CanRig(models)
    near = np.full(3, 500)
    rig.writer.set_goal_limits(-near, near)
    monkeypatch.setattr(codec, "command", aside)
    for give in (rig.writer.goals, lambda ticks: next(rig.writer.write_goals(ticks))):
        with pytest.raises(WireRangeError) as refused:
            give(np.zeros(3, np.int64))
        found = refused.value
        assert (found.id, found.lower, found.upper) == (1, -500.0, 500.0)
        assert found.value == pytest.approx(900.0, abs=1.0)
        assert rig.reader.line.goals is None
    if codec is CubeMarsCodec:
        with pytest.raises(WireRangeError):  # the soft poll is checked, too
            rig.writer.set_goal_limits(-near, near)
