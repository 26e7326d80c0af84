"""A few SIGKILLs of the real daemon at random phases; `make kills N=100` has more of them."""

from tests.support.sigkill_runs import COUNTS, TRIP, killing


def test_a_killed_daemon_leaves_servos_that_stop_and_a_restart_that_moves_nothing() -> None:
    kills, fronts = killing(3, seed=20261122, phases=("streaming", "arming", "moving"))
    assert [kill.phase for kill in kills] == ["streaming", "arming", "moving"]
    assert len(fronts) == 1
    moving = kills[-1]
    assert (moving.told + moving.cut, moving.cut) == (moving.acknowledged, 1)
    assert kills[0].torque == moving.torque == 24
    assert all(0.09 < delay <= TRIP for kill in kills for delay in kill.trips)
    assert max(kill.moved for kill in kills) <= COUNTS
