"""The reference cases of joint_trajectory_controller: curves, and which messages are accepted.

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
from twind.robot.splines import interpolate, passed
from twind.robot.trajectory import Reference, Trajectory
from twind.safety.gate import TrajectoryRequest
from twind.safety.trajectory_validation import PointRow, form

CASES = json.loads((Path(__file__).parents[1] / "data" / "jtc_cases.json").read_text())
EPS = 1e-8


def named(group: str) -> Any:
    return pytest.mark.parametrize("case", CASES[group], ids=lambda case: case.get("id", ""))


def reference(point: dict[str, float]) -> Reference:
    """Return the state before a trajectory; a value that the point lacks counts as 0."""
    return Reference(*(np.array([float(point.get(key, 0.0))]) for key in "pva"))


def drawn(points: list[dict[str, float]]) -> Trajectory:
    """Return the points of one joint as a path."""
    time = np.array([point["t"] for point in points])
    position, velocity, acceleration = (
        np.array([[point[key]] for point in points]) if key in points[0] else None for key in "pva"
    )
    return Trajectory(time, position, np.ones(1, np.bool_), velocity, acceleration)


def test_every_group_of_curves_is_run_here() -> None:
    sizes = {key: len(CASES[key]) for key in ("interpolate_segment", "sample_trajectory")}
    assert sizes == {"interpolate_segment": 1, "sample_trajectory": 3}
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
    path = drawn(case["points"])
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


# ------------------------------------------------------------------------------------------ what is accepted

GROUP = CASES["validate"]
JOINTS = tuple(GROUP["controller_joints"])
STRICTER = {
    # id: our code, and why
    # END_NOT_AT_REST: a moving end needs append_stop; the group runs without that check
    "good": ReasonCode.END_NOT_AT_REST,
    "ends_in_the_future": ReasonCode.END_NOT_AT_REST,  # END_NOT_AT_REST, as above
    # BAD_SHAPE: the socket takes positions
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
