"""The reference cases of joint_trajectory_controller: curves, fill, whole turns, and what is accepted.

Where our gate is stricter, or lets something through that the controller does not, the test names the rule.
The cases of the executor are in test_jtc_executor.py.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support import gate_rig as w
from twind.robot.finding import ReasonCode
from twind.robot.splines import fill, integrate, interpolate, nearest_turn, passed
from twind.robot.trajectory import Reference, Trajectory
from twind.safety.gate import TrajectoryRequest
from twind.safety.trajectory_validation import PointRow, form

CASES = json.loads((Path(__file__).parents[1] / "data" / "jtc_cases.json").read_text())
EPS = 1e-8


def named(group: str) -> Any:
    return pytest.mark.parametrize("case", CASES[group], ids=lambda case: case.get("id", ""))


def reference(point: dict[str, float]) -> Reference:
    """What a point does not say counts as 0 in the state before."""
    return Reference(*(np.array([float(point.get(key, 0.0))]) for key in "pva"))


def drawn(points: list[dict[str, float]], before: Reference) -> Trajectory:
    """One joint's points as a path; what is missing is summed up."""
    time = np.array([point["t"] for point in points])
    rows = {
        key: np.array([[point.get(key, np.nan)] for point in points])
        if any(key in point for point in points)
        else None
        for key in "pva"
    }
    if rows["p"] is not None and not np.isnan(rows["p"]).any():
        return Trajectory(time, rows["p"], np.ones(1, np.bool_), rows["v"], rows["a"])
    return integrate(time, before, rows["v"], rows["a"], rows["p"])


def test_every_group_of_curves_is_run_here() -> None:
    sizes = {
        key: len(CASES[key]) for key in ("interpolate_segment", "sample_trajectory", "cubic_spline_fill")
    }
    assert sizes == {"interpolate_segment": 1, "sample_trajectory": 5, "cubic_spline_fill": 4}
    assert len(CASES["wraparound"]) == 2
    assert len(CASES["validate"]["cases"]) == 10


@named("interpolate_segment")
def test_a_segment_follows_its_polynomial(case: dict[str, Any]) -> None:
    before = reference(case["start"])
    T = case["t1"] - case["t0"]
    end = case["end"]  # its acceleration is ignored: the other end has none
    path = Trajectory(
        np.array([T]), np.array([[float(end["p"])]]), np.ones(1, np.bool_), np.array([[float(end["v"])]])
    )
    spline = interpolate(path, before)
    for expected in case["expect"]:
        at = spline.inside(0, expected["t"] - case["t0"])
        assert at.position[0] == pytest.approx(expected["p"], abs=EPS)
        assert at.velocity[0] == pytest.approx(expected["v"], abs=EPS)
        assert at.acceleration[0] == pytest.approx(expected["a"], abs=EPS)


@named("sample_trajectory")
def test_a_trajectory_is_sampled_as_expected(case: dict[str, Any]) -> None:
    before = reference(case["before"])
    path = drawn(case["points"], before)
    spline = interpolate(path, before)
    for expected in case["expect"]:
        t = expected["t"]
        at = spline.sample(t)
        assert (at is not None) is expected.get("ok", True)
        if at is None:
            assert passed(path, t) == expected.get("index", 0)
            continue
        assert np.isfinite(at.position).all()
        if t == path.time[-1] and "v" in expected:
            at = spline.inside(len(spline.coefficients) - 1, t)
        elif t in path.time:  # the controller reports the segment that ends here, ours the one that begins
            at = spline.inside(spline.segment(t) - 1, t)
        for key, value in (("p", at.position), ("v", at.velocity), ("a", at.acceleration)):
            if key in expected:
                assert value[0] == pytest.approx(expected[key], abs=EPS)
        if "index" in expected:
            assert passed(path, t) == expected["index"]


def test_a_knot_belongs_to_both_of_its_segments() -> None:
    spline = interpolate(w.path([1.0, 2.0], [1.0, 3.0]), w.at_rest([0.0]))
    assert spline.inside(0, 1.0).velocity[0] == 1.0
    assert spline.sample(1.0).velocity[0] == 2.0
    assert spline.inside(0, 1.0).position[0] == spline.sample(1.0).position[0] == 1.0


def test_integrated_goals_that_are_skipped_still_give_the_summed_position() -> None:
    (case,) = [case for case in CASES["sample_trajectory"] if case["id"].startswith("last_segment_skipped")]
    before = reference(case["before"])
    path = drawn(case["points"], before)
    assert path.position[:, 0] == pytest.approx([0.0, 1.0, 1.001])
    assert interpolate(path, before).sample(3.0).position[0] == pytest.approx(1.001)


def test_accelerations_alone_are_summed_up_twice() -> None:
    path = integrate(np.array([1.0, 2.0]), w.at_rest([0.5]), acceleration=np.array([[2.0], [0.0]]))
    assert path.velocity[:, 0].tolist() == [1.0, 2.0]  # (0 + 2) / 2, then + (2 + 0) / 2
    assert path.position[:, 0].tolist() == [1.0, 2.5]
    assert path.acceleration[:, 0].tolist() == [2.0, 0.0]


def test_a_segment_without_a_position_raises_an_error() -> None:
    before = w.at_rest([0.0])
    time = np.array([1.0, 2.0])
    nothing = np.array([[0.1], [np.nan]])
    with pytest.raises(ValueError, match="neither"):
        integrate(time, before, nothing)
    with pytest.raises(ValueError, match="neither"):
        integrate(time, before)
    for bad in ([2.0, 1.0], [-1.0, 1.0], [np.nan, 1.0], []):
        with pytest.raises(ValueError, match="times"):
            integrate(np.array(bad), before, np.zeros((len(bad), 1)))


def test_joints_that_are_not_commanded_need_nothing_to_be_summed_up_from() -> None:
    given = np.array([[1.0, np.nan]])
    path = integrate(np.array([1.0]), w.at_rest([0.0, 7.0]), given, commanded=np.array([True, False]))
    assert path.position[0, 0] == 0.5
    assert path.velocity is not None


@named("cubic_spline_fill")
def test_a_position_chunk_is_filled_smoothly(case: dict[str, Any]) -> None:
    if case["id"] == "smooth_not_staircase":
        return _smooth(case)
    position = np.array(case["p"], np.float64)[:, None]
    time = case.get("dt", 0.1) * np.arange(len(position))
    untouched = position.copy()
    if case.get("ok", True):
        assert fill(time, position)[:, 0] == pytest.approx(case["expect_v"], abs=case["tol"])
    else:
        with pytest.raises(ValueError, match="smooth fill"):
            fill(time, position)
    assert np.array_equal(position, untouched)
    return None


def _smooth(case: dict[str, Any]) -> None:
    """In the case's words: peak second difference at 2 ms < 2 analytic + 1; the unfilled one > 3 filled."""
    s = np.arange(case["n"]) / (case["n"] - 1)
    time = case["dt"] * np.arange(case["n"])
    position = (0.1 + 0.5 * np.sin(np.pi * s) ** 2)[:, None]
    both = np.ones(1, np.bool_)
    before = w.at_rest(position[0])

    def peak(path: Trajectory) -> float:
        spline = interpolate(path, before)
        step = 0.002
        row = [spline.sample(t).position[0] for t in np.arange(0.0, time[-1], step)]
        return float(np.abs(np.diff(row, 2)).max() / step**2)

    filled = peak(Trajectory(time, position, both, fill(time, position)))
    unfilled = peak(Trajectory(time, position, both))
    analytic = 0.5 * 2.0 * np.pi**2 / (case["dt"] * (case["n"] - 1)) ** 2
    assert filled < 2.0 * analytic + 1.0
    assert unfilled > 3.0 * filled


def test_a_fill_has_no_step_in_acceleration_and_rests_at_both_ends() -> None:
    rng = np.random.default_rng(7)
    time = np.cumsum(rng.uniform(0.05, 0.5, 9))
    position = rng.uniform(-1.0, 1.0, (9, 3))
    velocity = fill(time, position)
    spline = interpolate(
        Trajectory(time - time[0], position, np.ones(3, np.bool_), velocity), w.at_rest(position[0])
    )
    for i in range(1, len(time) - 1):
        t = spline.time[i]
        assert spline.inside(i - 1, t).acceleration == pytest.approx(
            spline.inside(i, t).acceleration, abs=1e-9
        )
    assert not velocity[[0, -1]].any()
    assert fill(np.array([0.0, 1.0]), np.array([[0.0], [1.0]])).tolist() == [[0.0], [0.0]]


@named("wraparound")
def test_continuous_joints_start_from_the_nearest_turn(case: dict[str, Any]) -> None:
    mask = np.array(case["mask"])
    moved = nearest_turn(np.array(case["current"], np.float64), np.array(case["next"]), mask)
    assert moved == pytest.approx(case["expect"], abs=EPS)


# ------------------------------------------------------------------------------------------ what is accepted

GROUP = CASES["validate"]
JOINTS = tuple(GROUP["controller_joints"])
STRICTER = {
    # id: our code, and why
    # END_NOT_AT_REST: a moving end needs append_stop; the group runs without that check
    "good": ReasonCode.END_NOT_AT_REST,
    "ends_in_the_future": ReasonCode.END_NOT_AT_REST,  # END_NOT_AT_REST, as above
    # BAD_SHAPE: the socket takes positions; `integrate` makes them
    "integration_no_positions": ReasonCode.BAD_SHAPE,
}


def message(case: dict[str, Any]) -> list[PointRow | tuple[Any, ...]]:
    """The case's message as rows: good, with the changes the case names."""
    point = {**GROUP["good"]["points"][0]}
    if "accelerations" in case.get("base", ""):
        point["accelerations"] = [0.0, 0.0, 0.0]
    points = [point | case.get("point0", {})] if case.get("set", {}).get("points") != [] else []
    if case.get("append_copy_of_point0"):
        points *= 2
    keys = ("t", "positions", "velocities", "accelerations", "effort")
    return [tuple(p.get(key) for key in keys[: 5 if "effort" in p else 4]) for p in points]


def answers(rows: list[PointRow | tuple[Any, ...]], demand: TrajectoryRequest) -> set[ReasonCode]:
    """The codes of form and gate for a robot that is strong and wide enough for the case."""
    path, findings = form(JOINTS, rows, JOINTS)
    if path is None:
        return {finding.code for finding in findings}
    wide = w.limits(3, lower=-9.0, upper=9.0, velocity=99.0, acceleration=999.0)
    return w.codes(w.ask(path, wide, w.at_rest(np.zeros(3)), demand))


@pytest.mark.parametrize("case", GROUP["cases"], ids=lambda case: case["id"])
def test_messages_are_accepted_as_by_the_controller_or_more_strictly(case: dict[str, Any]) -> None:
    refused = answers(message(case), TrajectoryRequest())
    if not case["accept"]:
        assert refused
    elif case["id"] in STRICTER:
        assert refused == {STRICTER[case["id"]]}
    else:
        assert refused == set()


@pytest.mark.parametrize("id", ["good", "ends_in_the_future"])
def test_with_a_stop_appended_the_good_ones_pass(id: str) -> None:
    (case,) = [case for case in GROUP["cases"] if case["id"] == id]
    assert answers(message(case), TrajectoryRequest(append_stop=True)) == set()


def test_goals_without_positions_pass_once_they_are_summed_up() -> None:
    velocity = np.array([GROUP["good"]["points"][0]["velocities"]], np.float64)
    path = integrate(np.array([0.25]), w.at_rest(np.zeros(3)), velocity, np.zeros((1, 3)))
    rows = [
        PointRow(0.25, *(block[0].tolist() for block in (path.position, path.velocity, path.acceleration)))
    ]
    assert answers(rows, TrajectoryRequest(append_stop=True)) == set()


def test_a_last_velocity_below_what_counts_as_rest_passes_here_and_not_upstream() -> None:
    """Upstream's bound is the float32 epsilon; END_NOT_AT_REST's is 0.05 rad/s."""
    assert answers([PointRow(1.0, [0.0] * 3, [1e-6] * 3)], TrajectoryRequest()) == set()


def test_input_unchecked_by_the_reference_is_refused_here() -> None:
    nan = float("nan")
    good = [0.1, 0.1, 0.1]
    assert answers([PointRow(1.0, [nan, 0.0, 0.0])], TrajectoryRequest()) == {ReasonCode.NONFINITE}
    assert answers([PointRow(1.0, [10.0, 0.0, 0.0])], TrajectoryRequest()) >= {ReasonCode.POS_LIMIT}
    assert answers([PointRow(-1.0, good)], TrajectoryRequest()) == {ReasonCode.TIME_ORDER}
    assert answers([PointRow(0.0, good)], TrajectoryRequest()) == {ReasonCode.START_JUMP}
    assert [f.code for f in form(["joint1", "joint1"], [PointRow(1.0, [0.0, 0.0])], JOINTS)[1]] == [
        ReasonCode.DUP_JOINT
    ]
