"""The reference cases `executor` and `action` of joint_trajectory_controller, run on the pure executor.

Each case has a function here; a case without one fails the first test. Where the house is stricter than
upstream, the case says by which rule, and what is compared then.
"""

import json
from collections.abc import Callable
from math import inf
from pathlib import Path

import numpy as np
import pytest

from tests.support.gate_rig import ask, at_rest, codes, limits
from twind.motion.stop_profiles import StopRamp
from twind.motion.trajectory_executor import GoalOutcome, GoalTolerances, TrajectoryExecutor
from twind.robot.finding import ReasonCode
from twind.robot.joint_state import JointState
from twind.robot.modes import Motion
from twind.robot.trajectory import Reference, Trajectory

FILE = json.loads((Path(__file__).parents[1] / "data" / "jtc_cases.json").read_text())
CASES = {(group, case["id"]): case for group in ("executor", "action") for case in FILE[group]["cases"]}
START = np.array(FILE["executor"]["initial_position"], float)
TOL = FILE["executor"]["tol"]
NAMES = FILE["validate"]["controller_joints"]
LIMITS = limits(3, lower=-100.0, upper=100.0, velocity=1000.0, acceleration=10.0)


class World:
    """An executor whose robot follows at once, or stands still; `track` keeps every reference."""

    def __init__(self, *, follows: bool = True, period: float = 0.01) -> None:
        self.executor = TrajectoryExecutor(LIMITS, period)
        self.follows = follows
        self.period = period
        self.executor.begin(START)
        self.track: list[Reference] = [at_rest(START)]
        self.outcomes: list[GoalOutcome] = []
        self.now = 0.0

    def run(self, seconds: float, wall: float = 0.01) -> Reference:
        for _ in range(round(seconds / wall)):
            self.now += wall
            reference = self.executor.goal(self.now)
            assert reference is not None
            self.track.append(reference)
            there = reference.position if self.follows else START
            speed = reference.velocity if self.follows else np.zeros(3)
            effort = np.full(3, np.nan)
            age = np.zeros(3)
            self.executor.observe(JointState(self.now, there, speed, effort, age, np.ones(3, bool)))
            self.outcomes += self.executor.outcomes()
        return self.track[-1]

    def submit(self, name: str, points: list, **how: object) -> None:
        assert self.executor.submit(name, path(points), **how) is None

    def phase(self, name: str) -> str:
        return {outcome.id: outcome.phase for outcome in self.outcomes}[name]

    def codes(self, name: str) -> set[ReasonCode]:
        return {
            finding.code for outcome in self.outcomes if outcome.id == name for finding in outcome.findings
        }


def path(points: list) -> Trajectory:
    """Points of the file; a point of fewer joints names the first ones, or those of `joints`."""
    places = [NAMES.index(name) for name in points[0].get("joints", NAMES[: len(points[0]["p"])])]

    def rows(key: str) -> np.ndarray | None:
        if key not in points[0]:
            return None
        full = np.full((len(points), 3), np.nan)  # columns that are not commanded are never looked at
        full[:, places] = [point[key] for point in points]
        return full

    position = rows("p")
    assert position is not None
    commanded = np.zeros(3, bool)
    commanded[places] = True
    return Trajectory(np.array([float(point["t"]) for point in points]), position, commanded, rows("v"))


def steps(world: World) -> np.ndarray:
    return np.abs(np.diff([reference.position for reference in world.track], axis=0))


# --------------------------------------------------------------------------------------------- executor


def jumbled_joint_order(case: dict) -> None:
    point = case["points"][0]
    message = {name: point["p_in_controller_order"][NAMES.index(name)] for name in case["msg_order"]}
    world = World()
    world.submit("a", [{"t": point["t"], "joints": list(message), "p": list(message.values())}])
    reached = world.run(case["expect_at"]["t"])
    assert reached.position == pytest.approx(case["expect_at"]["p"], abs=TOL)


def replace_partial(case: dict) -> None:
    """Both goals end moving, refused by END_NOT_AT_REST; without the gate the curve ends as upstream's."""
    world = World()
    world.submit("old", case["old"])
    world.run(case["new_at"])
    world.submit("new", case["new"])
    end = world.run(case["new"][0]["t"])
    assert end.position == pytest.approx(case["expect_at_end"]["p"], abs=case["tol"])
    before = world.track[
        -2
    ]  # at the end itself ours is at rest (END_NOT_AT_REST): compare what the curve ran up to
    arriving = before.velocity + 0.01 * before.acceleration
    assert arriving == pytest.approx(case["expect_at_end"]["v"], abs=case["tol"])
    assert ReasonCode.END_NOT_AT_REST in codes(ask(path(case["old"]), LIMITS, at_rest(START)))


def partly_old(case: dict) -> None:
    """By the documented rule: waypoints that are past are dropped, the future one is taken (-2, -4, -6).

    The number in the table (4, 5, 6) is that of an upstream test that mixes two clocks.
    """
    world = World()
    world.submit("old", case["old"])
    world.run(case["new_at"])
    world.submit("new", case["new"], start_in=-0.6)
    end = world.run(case["new"][-1]["t"] - 0.6)
    assert end.position == pytest.approx([-2.0, -4.0, -6.0], abs=1e-9)
    assert world.phase("old") == "replaced"
    assert world.phase("new") == "succeeded"
    refused = world.executor.submit("past", path(case["new"]), start_in=-1.0)
    assert refused is not None
    assert refused.code is ReasonCode.CMD_EXPIRED


def omitted_joint_keeps_old_path(case: dict) -> None:
    world = World()
    world.submit("old", case["old"])
    world.run(case["new_at"])
    world.submit("new", case["new"])
    world.run(2.0)
    joint3 = [reference.position[2] for reference in world.track]
    assert joint3[170] > joint3[110] + 0.5


def old_path_kept_until_future_stamp(case: dict) -> None:
    world = World()
    world.submit("old", case["old"])
    world.run(case["new_at"])
    world.submit("new", case["new"], start_in=case["new_stamp"])
    world.run(1.4)
    assert max(reference.position[0] for reference in world.track) > 8.0


def successive_replacements(case: dict) -> None:
    world = World()
    world.submit("old", case["old"])
    for number, new in enumerate(case["then"]):
        world.run(new["at"] - world.now)
        world.submit(f"new {number}", new["points"], start_in=max(0.0, new["stamp"] - new["at"]))
    end = world.run(case["expect_at"]["t"] - world.now)
    assert end.position == pytest.approx(case["expect_at"]["p"], abs=case["tol"])


def handover_between_waypoints(case: dict) -> None:
    world = World()
    world.submit("old", case["old"])
    world.run(case["new_at"])
    world.submit("new", case["new"], start_in=case["new_stamp"] - case["new_at"])
    world.run(1.3)
    assert max(reference.position[0] for reference in world.track) == pytest.approx(27.5, abs=2.0)


def no_jump_under_speed_scaling(case: dict) -> None:
    """The factor multiplies the advance of trajectory time: here, half a period per tick."""
    world = World(period=0.01 * case["settings"]["initial_scaling_factor"])
    world.submit("old", case["old"])
    before = world.run(case["new_at"])
    assert before.position == pytest.approx((START + case["old"][0]["p"]) / 2, abs=TOL)
    world.submit("new", case["new"])
    after = world.run(0.03)
    assert np.abs(after.position - before.position).max() < 0.3


def stop_distance_positive(case: dict) -> None:
    moving = Reference(START, np.full(3, case["v0"]), np.zeros(3))
    ramp = StopRamp(moving, LIMITS, 0.01)
    assert ramp.duration == pytest.approx(0.02, abs=1e-12)
    assert ramp.reference_at(0.02).position == pytest.approx(START + 0.002, abs=1e-12)
    assert (ramp.reference_at(0.02).velocity == 0.0).all()


def decelerate_without_velocity_state(case: dict) -> None:
    assert case["settings"]["decelerate_on_cancel"]
    ramp = StopRamp(Reference(START, np.full(3, np.nan), np.zeros(3)), LIMITS, 0.01)
    assert ramp.duration == 0.0
    assert (ramp.step().position == START).all()


def cmd_timeout_accepted(case: dict) -> None:
    """Ours has no cmd_timeout: after the last point goal_time alone bounds a goal, nothing cuts it short."""
    goal_time = case["settings"]["goal_time"]
    world = World(follows=False)
    near = GoalTolerances.from_entries(3, [(0, None, 0.05)])
    world.submit("a", [{"t": 0.5, "p": [1, 2, 3]}], tolerances=near, goal_time=goal_time)
    world.run(0.5 + goal_time)
    assert world.outcomes == []
    world.run(0.02)
    assert world.phase("a") == "aborted"
    assert world.codes("a") == {ReasonCode.GOAL_TOLERANCE}


# ----------------------------------------------------------------------------------------------- action


def single_point(case: dict) -> None:
    world = World()
    world.submit("a", case["points"], goal_time=case["goal_time_tolerance"])
    end = world.run(case["points"][0]["t"])
    assert (world.phase("a"), world.codes("a")) == ("succeeded", set())
    assert end.position == pytest.approx(case["command_after"], abs=TOL)


def goal_tolerance_met(case: dict) -> None:
    world = World()
    bound = case["settings"]["goal"]
    world.submit(
        "a", case["points"], tolerances=GoalTolerances.from_entries(3, [(i, None, bound) for i in range(3)])
    )
    world.run(case["points"][0]["t"])
    assert world.phase("a") == "succeeded"


def preempted(case: dict) -> None:
    """Upstream calls it ABORTED with -1; the phase on our socket is `replaced`."""
    world = World()
    world.submit("first", case["first"])
    world.run(0.5)
    world.submit("second", case["second"])
    world.run(0.2)
    assert world.phase("first") == "replaced"
    assert world.phase("second") == "succeeded"


def path_tolerance(case: dict) -> None:
    """START_JUMP refuses a first point far away at t = 0; the executor alone never jumps either."""
    world = World(follows=False)
    bound = case["settings"]["trajectory"]
    world.submit(
        "a", case["points"], tolerances=GoalTolerances.from_entries(3, [(i, bound, None) for i in range(3)])
    )
    end = world.run(3.0)
    assert world.phase("a") == "aborted"
    assert world.codes("a") == {ReasonCode.PATH_TOLERANCE}
    assert end.position == pytest.approx(case["command_after"], abs=TOL)
    assert steps(world).max() < 0.1
    assert ReasonCode.START_JUMP in codes(ask(path(case["points"]), LIMITS, at_rest(START)))


def goal_tolerance(case: dict) -> None:
    """As above: START_JUMP refuses the jump; the executor leads in, waits for `goal_time`, and returns."""
    world = World(follows=False)
    bound = case["settings"]["goal"]
    goal_time = case["settings"]["goal_time"]
    tolerances = GoalTolerances.from_entries(3, [(i, None, bound) for i in range(3)])
    world.submit("a", case["points"], tolerances=tolerances, goal_time=goal_time)
    end = world.run(6.0)
    assert world.phase("a") == "aborted"
    assert world.codes("a") == {ReasonCode.GOAL_TOLERANCE}
    assert end.position == pytest.approx(case["command_after"], abs=TOL)
    assert ReasonCode.START_JUMP in codes(ask(path(case["points"]), LIMITS, at_rest(START)))


def cancel_decelerate(case: dict) -> None:
    assert case["settings"]["max_deceleration_on_cancel"] == LIMITS.acceleration[0]
    world = World()
    world.submit("a", case["points"])
    before = world.run(case["cancel_at"])
    world.executor.stop()
    world.run(0.5)
    assert world.phase("a") == "cancelled"
    assert (world.track[-1].velocity == 0.0).all()
    assert (world.track[-1].acceleration == 0.0).all()
    stops = before.position + before.velocity * np.abs(before.velocity) / 20.0
    assert world.track[-1].position == pytest.approx(stops, abs=1e-9)


def nonzero_end_velocity_forbidden(case: dict) -> None:
    """Upstream refuses above 1.2e-7, our gate above 0.05 rad/s (END_NOT_AT_REST), by the same rule."""
    assert not case["settings"]["allow_nonzero_velocity_at_trajectory_end"]
    assert ReasonCode.END_NOT_AT_REST in codes(ask(path(case["points"]), LIMITS, at_rest([4.0, 5.0, 6.0])))


def deactivated_while_running(case: dict) -> None:
    world = World()
    world.submit("a", case["points"])
    world.run(case["deactivate_at"])
    world.executor.idle()
    assert world.executor.motion is Motion.IDLE
    assert [outcome.phase for outcome in world.executor.outcomes()] == ["aborted"]


RUN: dict[tuple[str, str], Callable[[dict], None]] = {
    ("executor", "jumbled_joint_order"): jumbled_joint_order,
    ("executor", "replace_partial"): replace_partial,
    ("executor", "partly_old"): partly_old,
    ("executor", "omitted_joint_keeps_old_path"): omitted_joint_keeps_old_path,
    ("executor", "old_path_kept_until_future_stamp"): old_path_kept_until_future_stamp,
    ("executor", "successive_replacements"): successive_replacements,
    ("executor", "handover_between_waypoints"): handover_between_waypoints,
    ("executor", "no_jump_under_speed_scaling"): no_jump_under_speed_scaling,
    ("executor", "stop_distance_positive"): stop_distance_positive,
    ("executor", "decelerate_without_velocity_state"): decelerate_without_velocity_state,
    ("executor", "cmd_timeout_accepted"): cmd_timeout_accepted,
    ("action", "single_point"): single_point,
    ("action", "goal_tolerance_met"): goal_tolerance_met,
    ("action", "preempted"): preempted,
    ("action", "path_tolerance"): path_tolerance,
    ("action", "goal_tolerance"): goal_tolerance,
    ("action", "cancel_decelerate"): cancel_decelerate,
    ("action", "nonzero_end_velocity_forbidden"): nonzero_end_velocity_forbidden,
    ("action", "deactivated_while_running"): deactivated_while_running,
}


def test_every_case_of_the_file_is_run() -> None:
    assert set(RUN) == set(CASES)


@pytest.mark.parametrize("which", RUN, ids="/".join)
def test_the_executor_answers_as_joint_trajectory_controller(which: tuple[str, str]) -> None:
    RUN[which](CASES[which])


def test_tolerance_values_have_the_meaning_of_the_reference_file() -> None:
    assert FILE["action"]["tolerance_value"]["-1"].startswith("erased")
    given = GoalTolerances.from_entries(3, [(0, 0.0, -1.0), (1, 0.2, None), (2, None, 0.3)])
    assert given.path.tolist() == [inf, 0.2, inf]
    assert given.goal.tolist() == [inf, inf, 0.3]
