"""A whole way is judged: what is accepted is clear everywhere, what is refused is not; both are said well."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.clearance_rig import Oracle, arm, at, finished, h24, line, still, wander
from twind.robot.finding import ReasonCode
from twind.robot.splines import Spline, hold, interpolate
from twind.robot.trajectory import Trajectory
from twind.twin import curve_sweep
from twind.twin.collision_model import CollisionModel
from twind.twin.curve_sweep import BAND, CHUNK, SLACK, CurveSweep, SweepResult

FLOOR = '<geom name="floor" type="plane" size="2 2 0.1"/>'
OPEN = "{allow: [[base, middle]]}"  # so that the tip alone comes back to the base
POST = '<geom name="post" type="capsule" fromto="0.3 -1 0.45 0.3 1 0.45" size="0.004"/>'


def sweep_curve(bodies: CollisionModel, curve: Spline) -> SweepResult:
    found = finished(CurveSweep(bodies).running(curve))
    assert isinstance(found, SweepResult)
    return found


def named(bodies: CollisionModel, found: SweepResult) -> list[tuple[str, str]]:
    return [bodies.pairs[close.pair].bodies for close in found.refused]


def closest_pose(bodies: CollisionModel, clearance: float) -> np.ndarray:
    """Return the pose in which the elbow leaves `clearance` m between tip and base."""
    pair = [each.bodies for each in bodies.pairs].index(("base", "tip"))
    low = 0.0
    high = 2.9
    for _ in range(50):
        middle = 0.5 * (low + high)
        bodies.place(np.array([0.0, middle, 0.0]))
        low, high = (middle, high) if bodies.between(pair, 1.0) > clearance else (low, middle)
    return np.array([0.0, 0.5 * (low + high), 0.0])


def against_the_oracle(seed: int, count: int, share: float) -> tuple[int, int, int]:
    """Accepted, refused, refused although clear by more than the band: never accepted although not clear."""
    binding = h24()
    bodies = CollisionModel(binding)
    oracle = Oracle(binding, [pair.geoms for pair in bodies.pairs])
    random = np.random.default_rng(seed)
    accepted = refused = wrongly = 0
    while accepted + refused < count:
        curve = wander(random, binding, share)
        if (oracle.row(at(curve, 0.0)) < bodies.block + BAND).any():
            continue
        found = sweep_curve(bodies, curve)
        spare = float((oracle.least(curve, 200) - bodies.block).min())
        if found.refused or found.unfinished:
            refused += 1
            wrongly += spare > BAND
        else:
            accepted += 1
            assert spare > 0.0, f"accepted, but {spare * 1e3:.3f} mm inside the bound"
    return accepted, refused, wrongly


def test_nothing_is_accepted_that_comes_too_close() -> None:
    accepted, refused, wrongly = against_the_oracle(11, 25, 0.5)
    assert accepted > 10
    assert refused > 0
    assert wrongly == 0


@pytest.mark.campaign
def test_nothing_is_accepted_that_comes_too_close_in_a_thousand_ways() -> None:
    accepted, refused, wrongly = against_the_oracle(12, 1000, 0.45)
    assert accepted > 300
    assert refused > 30
    assert wrongly == 0


def test_a_collision_between_two_samples_is_found(tmp_path: Path) -> None:
    """A thin post: both ends are clear by 2 cm and more, and the tip passes through in the middle."""
    binding = arm(tmp_path, "{world_m: 0.001}", support="fixed", world=POST, tip="sphere")
    bodies = CollisionModel(binding)
    found = sweep_curve(bodies, line([-0.9, 0.0, 0.0], [-0.1, 0.0, 0.0]))
    assert {bodies.pairs[close.pair].code for close in found.refused} == {ReasonCode.KEEP_OUT}
    first = found.refused[0]
    assert first.clearance < 0.0
    assert 0.0 < first.time < first.at < 1.0
    bodies.place(at(line([-0.9, 0.0, 0.0], [-0.1, 0.0, 0.0]), first.time))
    assert bodies.between(first.pair, 1.0) == pytest.approx(0.001, abs=2e-4)


def test_the_floor_has_its_own_name(tmp_path: Path) -> None:
    bodies = CollisionModel(arm(tmp_path, support="fixed", world=FLOOR))
    found = sweep_curve(bodies, line([0.0, 0.0, 0.0], [0.75, 0.0, 0.0]))
    assert bodies.pairs[found.refused[0].pair].code is ReasonCode.FLOOR
    assert ("floor", "tip") in named(bodies, found)
    assert not sweep_curve(bodies, line([0.0, 0.0, 0.0], [-0.75, 0.0, 0.0])).refused


def test_two_boxes_are_checked_although_contacts_do_not_cover_them(tmp_path: Path) -> None:
    bodies = CollisionModel(arm(tmp_path, OPEN, tip="box"))
    assert len(bodies.boxes)
    found = sweep_curve(bodies, line([0.0, 0.0, 0.0], [0.0, 2.85, 0.0]))
    assert ("base", "tip") in named(bodies, found)
    clear = sweep_curve(bodies, line([0.0, 0.0, 0.0], [0.0, 1.4, 0.4]))
    assert not clear.refused


def test_a_small_clearance_is_reported_and_not_refused(tmp_path: Path) -> None:
    """The tip goes straight at the base's top until 5 mm are left."""
    bodies = CollisionModel(arm(tmp_path, OPEN))
    found = sweep_curve(bodies, line(np.zeros(3), closest_pose(bodies, 0.005)))
    assert not found.refused
    near = {bodies.pairs[close.pair].bodies: close for close in found.warned}["base", "tip"]
    assert near.clearance == pytest.approx(0.005, abs=1e-5)


@pytest.mark.parametrize("beyond", [-2e-3, -3e-4, -BAND / 2, BAND / 2, 1e-3, 1e-2])
def test_a_way_is_refused_from_the_bound_on(tmp_path: Path, beyond: float) -> None:
    """Dense around the bound: the way ends where the tip is `beyond` further into it than `block`."""
    bodies = CollisionModel(arm(tmp_path, OPEN))
    found = sweep_curve(bodies, line(np.zeros(3), closest_pose(bodies, 0.002 - beyond)))
    if abs(beyond) > BAND:
        assert bool(found.refused) == (beyond > 0.0)
    elif beyond > 0.0:
        assert found.refused


@pytest.mark.parametrize("deep", [-BAND / 2, BAND, 0.001, 0.005])
def test_a_robot_that_starts_too_close_may_leave_and_not_come_closer(tmp_path: Path, deep: float) -> None:
    bodies = CollisionModel(arm(tmp_path, OPEN))
    start = closest_pose(bodies, 0.002 - deep)
    out = sweep_curve(bodies, line(start, [0.0, 0.0, 0.0]))
    assert not out.refused
    assert not out.unfinished
    closer = sweep_curve(bodies, line(start, start + np.array([0.0, 0.1, 0.0])))
    assert named(bodies, closer) == [("base", "tip")]
    back = sweep_curve(bodies, line(start, [0.0, 0.0, 0.0], closest_pose(bodies, 0.002 - deep - 0.0002)))
    assert named(bodies, back) == [("base", "tip")]  # once out, the bound holds again
    assert SLACK < 0.002


def test_a_way_that_does_not_move_is_clear() -> None:
    binding = h24()
    found = sweep_curve(CollisionModel(binding), hold(np.array(binding.rest)))
    assert (found.refused, found.warned, found.unfinished) == ((), (), False)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e300])
def test_a_non_finite_path_is_never_proved_clear(tmp_path: Path, wrong: float) -> None:
    bodies = CollisionModel(arm(tmp_path))
    with np.errstate(all="ignore"):
        path = Trajectory(np.ones(1), np.array([[0.0, wrong, 0.0]]), np.ones(3, np.bool_))
        found = sweep_curve(bodies, interpolate(path, still(np.zeros(3))))
    assert found.unfinished


def test_the_work_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(curve_sweep, "MOST", 200)
    bodies = CollisionModel(arm(tmp_path))
    rows = [[0.0, 1.0 * (k % 2), 0.0] for k in range(200)]
    found = sweep_curve(bodies, line(*rows, seconds=0.5))
    assert found.unfinished
    assert found.work <= 200 + 2 * CHUNK


def test_slices_are_short() -> None:
    """By work, not by the clock: no more than some poses between two yields."""
    binding = h24()
    bodies = CollisionModel(binding)
    sweeping = CurveSweep(bodies)
    worked = [0]
    random = np.random.default_rng(5)
    finished(sweeping.running(wander(random, binding, 0.5)), lambda: worked.append(sweeping.work))
    assert max(np.diff(worked)) <= 4 * CHUNK


def test_the_degree_and_the_speed_of_a_way_make_no_difference(tmp_path: Path) -> None:
    """The same geometry, slower: stretched in time from rest, a curve stays where it is (`retime`)."""
    bodies = CollisionModel(arm(tmp_path))
    path = Trajectory(
        np.array([1.0, 2.0]),
        np.array([[0.0, 1.0, 0.5], [0.3, 2.2, 0.0]]),
        np.ones(3, np.bool_),
        np.array([[0.1, 1.0, 0.0], [0.0, 0.0, 0.0]]),
    )
    fast = sweep_curve(bodies, interpolate(path, still(np.zeros(3))))
    slow = sweep_curve(bodies, interpolate(path.stretched(3.0), still(np.zeros(3))))
    assert named(bodies, fast) == named(bodies, slow)
    assert [close.time * 3.0 for close in fast.refused] == pytest.approx([c.time for c in slow.refused])
