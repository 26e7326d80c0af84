"""Transitions of the torque state: each changes what its name says, and nothing else."""

import numpy as np
import pytest

from twind.loop.procedures.torque_state import TorqueState

FIELDS = (
    "armed",
    "energising",
    "held",
    "inhibited",
    "limp",
    "partial",
    "pending_restore",
    "soft_since",
    "stop_begun",
    "stop_level",
    "unconfirmed",
)
ALL = np.ones(3, np.bool_)
SOME = np.array([True, False, True])
NONE = np.zeros(3, np.bool_)
FIRST = np.array([True, False, False])
NO_LIMP = {"limp": (False,) * 3, "partial": False}


def values(torque: TorqueState) -> dict[str, object]:
    """Every field by name; `held` and `limp` as tuples."""
    found = {name: getattr(torque, name) for name in FIELDS}
    return found | {"held": tuple(torque.held.tolist()), "limp": tuple(torque.limp.tolist())}


AT_START = {
    "armed": False,
    "energising": False,
    "held": (False, False, False),
    "inhibited": False,
    "limp": (False, False, False),
    "partial": False,
    "pending_restore": False,
    "soft_since": None,
    "stop_begun": False,
    "stop_level": None,
    "unconfirmed": False,
}
EVERYTHING = {
    "armed": True,
    "energising": True,
    "held": (True, True, True),
    "inhibited": True,
    "limp": (True, False, False),
    "partial": True,
    "pending_restore": True,
    "soft_since": 5.0,
    "stop_begun": True,
    "stop_level": "settle",
    "unconfirmed": True,
}


def busy() -> TorqueState:
    """A state in which every field differs from the start."""
    torque = TorqueState(3)
    torque.leave_limp(FIRST)
    torque.take_hold(ALL)
    torque.lose_bus(NONE)
    torque.begin_energising()
    torque.abandon_switching()
    torque.inhibit()
    torque.demand_damping(5.0)
    torque.latch_stop("settle")
    torque.confirm_stop_begun()
    return torque


def test_a_daemon_begins_without_torque_and_without_a_latch() -> None:
    assert values(TorqueState(3)) == AT_START
    assert values(busy()) == EVERYTHING


@pytest.mark.parametrize(
    ("transition", "changed"),
    [
        ("begin_energising", {}),
        ("abandon_switching", {}),
        (
            "begin_release",
            {"held": (False,) * 3, "armed": False, "soft_since": None} | NO_LIMP,
        ),
        ("defer_release", {}),
        ("confirm_off", {"energising": False}),  # a lost bus has not confirmed
        ("leave_unconfirmed", {"energising": False}),
        ("find_off", {"unconfirmed": False, "pending_restore": False} | NO_LIMP),
        (
            "lose_every_bus",
            {"held": (False,) * 3, "armed": False, "energising": False, "soft_since": None} | NO_LIMP,
        ),
        ("end_damping", {"soft_since": None}),
        ("inhibit", {}),
        ("lift_inhibit", {"inhibited": False}),
        ("begin_stop", {"stop_begun": False}),
        ("confirm_stop_begun", {}),
        ("lift_stop", {"stop_level": None}),
    ],
)
def test_a_transition_ends_what_its_name_says_and_nothing_else(
    transition: str, changed: dict[str, object]
) -> None:
    torque = busy()
    getattr(torque, transition)()
    assert values(torque) == EVERYTHING | changed


@pytest.mark.parametrize(
    ("transition", "changed"),
    [
        ("begin_energising", {"energising": True}),
        ("abandon_switching", {}),
        ("begin_release", {"energising": True, "unconfirmed": True}),
        ("defer_release", {}),
        ("confirm_off", {}),
        ("leave_unconfirmed", {}),
        ("find_off", {}),
        ("lose_every_bus", {}),
        ("end_damping", {}),
        ("inhibit", {"inhibited": True}),
        ("lift_inhibit", {}),
        ("begin_stop", {}),
        ("confirm_stop_begun", {"stop_begun": True}),
        ("lift_stop", {}),
    ],
)
def test_a_transition_begins_what_its_name_says_and_nothing_else(
    transition: str, changed: dict[str, object]
) -> None:
    torque = TorqueState(3)
    getattr(torque, transition)()
    assert values(torque) == AT_START | changed


def test_a_hold_of_some_joints_is_armed_and_settles_what_was_open() -> None:
    torque = busy()
    torque.take_hold(SOME)
    expected = {"held": (True, False, True), "energising": False, "unconfirmed": False}
    assert values(torque) == EVERYTHING | expected
    torque.take_hold(NONE)
    assert torque.armed is False


def test_a_hold_of_all_joints_but_limp_ones_leaves_no_lost_bus_to_come_back() -> None:
    torque = busy()
    torque.take_hold(SOME)
    assert torque.pending_restore, "the knee may have torque on its bus"
    torque.leave_limp(~SOME)
    torque.take_hold(SOME)
    assert not torque.pending_restore
    assert not torque.unconfirmed


def test_torque_off_of_a_bus_that_is_lost_stays_unconfirmed_until_it_is_read() -> None:
    torque = TorqueState(3)
    torque.take_hold(ALL)
    torque.begin_release()
    torque.lose_bus(SOME)
    torque.begin_release()
    torque.confirm_off()  # by the other bus
    assert torque.unconfirmed
    torque.find_off()
    assert not torque.unconfirmed
    torque.begin_release()
    torque.confirm_off()
    assert not torque.unconfirmed


def test_the_joints_that_are_held_are_a_read_only_copy() -> None:
    torque = TorqueState(3)
    mine = SOME.copy()
    torque.take_hold(mine)
    mine[:] = False
    assert torque.held.tolist() == [True, False, True]
    with pytest.raises(ValueError, match="read-only"):
        torque.held[0] = False


def test_the_limp_joints_are_a_read_only_copy() -> None:
    torque = TorqueState(3)
    mine = FIRST.copy()
    torque.leave_limp(mine)
    mine[:] = True
    assert torque.limp.tolist() == [True, False, False]
    with pytest.raises(ValueError, match="read-only"):
        torque.limp[1] = True


def test_the_joints_of_a_lost_bus_are_not_held_until_it_is_back_and_takes_goals() -> None:
    torque = TorqueState(3)
    torque.take_hold(ALL)
    torque.lose_bus(SOME)
    assert torque.held.tolist() == [False, True, False]
    assert torque.armed and torque.pending_restore
    torque.lose_bus(~SOME)
    assert not torque.armed, "no joint is held"
    torque.regain_bus(SOME)
    assert torque.held.tolist() == [True, False, True]
    assert torque.armed and torque.pending_restore, "the other bus is still lost"


def test_switching_that_ends_half_way_is_switched_off_later() -> None:
    torque = TorqueState(3)
    torque.begin_energising()
    torque.abandon_switching()
    assert torque.unconfirmed
    torque.leave_unconfirmed()
    torque.abandon_switching()
    assert torque.unconfirmed and not torque.energising, "what is open stays open"


def test_damping_counts_from_its_first_demand() -> None:
    torque = TorqueState(3)
    assert torque.demand_damping(0.0) is True
    assert torque.demand_damping(7.0) is False
    assert torque.soft_since == 0.0
    torque.begin_release()
    assert torque.demand_damping(9.0) is True
    assert torque.soft_since == 9.0


@pytest.mark.parametrize("first", ["settle", "cut"])
@pytest.mark.parametrize("second", ["settle", "cut"])
def test_the_harder_level_of_two_stops_stays_latched(first: str, second: str) -> None:
    torque = TorqueState(3)
    torque.latch_stop(first)
    torque.latch_stop(second)
    assert torque.stop_level == ("cut" if "cut" in (first, second) else "settle")


@pytest.mark.parametrize("field", FIELDS)
def test_a_field_cannot_be_assigned_from_outside(field: str) -> None:
    with pytest.raises(AttributeError):
        setattr(TorqueState(3), field, True)
