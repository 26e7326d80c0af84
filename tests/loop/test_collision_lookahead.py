"""The way just ahead: what is near is seen in time, a stream can always stop clear, a hold costs nothing."""

from math import inf, isnan
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.clearance_rig import Oracle, arm, arm_file, at, h24
from tests.support.daemon_rig import MakeRig, Rig
from twind import link
from twind.config.robot_file import read_robot
from twind.motion.predicted_path import along, braking
from twind.motion.stop_profiles import StopRamp
from twind.motion.trajectory_executor import TrajectoryExecutor
from twind.robot.arrays import Floats
from twind.robot.modes import Mode, Motion
from twind.robot.splines import hold, interpolate
from twind.robot.trajectory import Reference, Trajectory
from twind.safety.guard_types import ClearanceAhead
from twind.twin.binding import Binding, bind
from twind.twin.clearance_bound import REACH
from twind.twin.collision_lookahead import CLEAR, LEAST, NEARER, CollisionLookahead
from twind.twin.collision_model import CollisionModel

PERIOD = 0.01
OPEN = "{allow: [[base, middle]]}"
ALL = np.ones(3, np.bool_)


class World:
    """An executor and what looks ahead of it."""

    def __init__(self, binding: Binding, start: list[float] | None = None) -> None:
        self.binding = binding
        self.bodies = CollisionModel(binding, 0.02)
        self.executor = TrajectoryExecutor(binding.limits, PERIOD)
        self.executor.begin(np.array(binding.rest if start is None else start))
        self.far = CollisionModel(binding, REACH)
        self.plain = CollisionModel(binding, 0.02)
        self.look = CollisionLookahead(self.bodies, self.far, binding.limits, PERIOD)
        self.oracle = Oracle(binding, [pair.geoms for pair in self.bodies.pairs])
        self.now = 0.0

    def tick(self) -> ClearanceAhead | None:
        self.now += PERIOD
        self.executor.goal(self.now)
        return self.look.look(self.executor)

    def clearance(self) -> float:
        assert self.executor.reference is not None
        return float((self.oracle.row(self.executor.reference.position) - self.bodies.block).min())


@pytest.fixture
def world(tmp_path: Path) -> World:
    return World(arm(tmp_path, OPEN))


def elbow(world: World, to: float, seconds: float) -> None:
    path = Trajectory(np.array([seconds]), np.array([[0.0, to, 0.0]]), ALL)
    assert world.executor.submit("a", path) is None


def test_a_hold_is_not_looked_at(world: World) -> None:
    assert world.tick() is None


def test_a_path_is_seen_to_come_near_in_time(world: World) -> None:
    elbow(world, 2.9, 2.9)
    said = None
    for _ in range(290):
        clear_now = world.clearance()
        said = world.tick()
        assert said is not None
        if said.clearance <= said.block:
            break
    assert said is not None
    assert set(said.pair) == {"base", "tip"}
    assert said.ahead == pytest.approx(LEAST, abs=2 * PERIOD)
    assert clear_now > 0.02  # there is time left
    assert (said.block, said.warn) == (0.002, 0.01)


def test_a_small_clearance_is_reported_before_a_blocking_one(world: World) -> None:
    elbow(world, 2.9, 2.9)
    told = [outlook.clearance for outlook in (world.tick() for _ in range(280)) if outlook is not None]
    near = [clearance for clearance in told if clearance < inf]
    assert near
    assert near[0] > 0.002
    assert near == sorted(near, reverse=True)


def counted(world: World, monkeypatch: pytest.MonkeyPatch) -> tuple[list[int], list[int]]:
    """Poses of each measurement, near and far."""
    near: list[int] = []
    far: list[int] = []
    for bodies, looked in ((world.bodies, near), (world.far, far)):

        def counting(poses: Floats, *more: Any, count: Any = looked, ask: Any = bodies.distances) -> Floats:
            count.append(len(poses))
            return ask(poses, *more)  # type: ignore[no-any-return]

        monkeypatch.setattr(bodies, "distances", counting)
    return near, far


def test_a_way_far_from_everything_is_measured_a_few_times(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    near, far = counted(world, monkeypatch)
    elbow(world, 1.0, 2.0)
    for _ in range(200):
        assert world.tick() in (None, CLEAR)
    assert near == []
    assert len(far) <= 10


def test_while_a_way_near_a_body_is_the_same_each_moment_is_measured_once(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    near, far = counted(world, monkeypatch)
    world.executor.begin(np.array([0.0, 2.62, 0.0]))
    elbow(world, 2.70, 2.0)
    for _ in range(150):
        world.tick()
    measured = sum(each for each in near if each > 1)
    assert 30 <= measured <= 30 + 150 + 10
    assert len(far) <= 16


def test_a_slow_robot_is_looked_further_ahead_in_as_many_poses(tmp_path: Path) -> None:
    robot = arm_file(tmp_path)
    text = (tmp_path / "arm.yaml").read_text().replace("gains:", "acceleration_limit_rad_s2: 3.0, gains:")
    (tmp_path / "arm.yaml").write_text(text)
    slow = World(bind(read_robot(robot.path), None))
    assert slow.look.times[-1] == pytest.approx(2.0 / 3.0, abs=PERIOD)
    assert len(slow.look.times) <= 30


def test_a_robot_that_starts_too_close_may_move_away(world: World) -> None:
    world.executor.begin(np.array([0.0, 2.75, 0.0]))
    assert world.clearance() < 0.0
    elbow(world, 1.0, 2.0)
    told = [world.tick() for _ in range(200)]
    assert {outlook.clearance for outlook in told if outlook is not None} == {inf}
    world.executor.begin(np.array([0.0, 2.75, 0.0]))
    elbow(world, 2.85, 1.0)
    outlook = world.tick()
    assert outlook is not None
    assert outlook.clearance < outlook.block
    assert outlook.ahead > 0.0


def test_a_nan_path_gives_a_nan_clearance(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    elbow(world, 1.0, 2.0)
    monkeypatch.setattr(
        "twind.motion.predicted_path.LookaheadPlan.course", lambda *_: np.full((1, 3), np.nan)
    )
    outlook = world.tick()
    assert outlook is not None
    assert isnan(outlook.clearance)


# --------------------------------------------------------------------------- against every pose in every tick


def every_pose(world: World) -> ClearanceAhead | None:
    """Return the report of this tick from a measurement of all poses of the time that counts."""
    plan = world.executor.plan
    if plan is None or world.executor.motion not in (Motion.ACTIVE, Motion.STREAMING):
        return None
    poses = plan.course(world.binding.limits, world.look.times)
    bodies = world.plain  # its own: measuring moves the bodies
    rows = bodies.distances(poses, bodies.boxes, bodies.reach)
    now = bodies.distances(plan.reference.position[None], bodies.boxes, bodies.reach)[0]
    least = rows.min(axis=0)
    spare = np.where(
        (least < bodies.block + bodies.band) & (least <= now - NEARER), least - bodies.block, inf
    )
    pair = int(spare.argmin())
    if not spare[pair] < inf:
        return CLEAR
    return ClearanceAhead(float(least[pair]), pair=bodies.pairs[pair].bodies)


def same_report(world: World) -> bool:
    """Check one tick against every pose measured; return whether something is near."""
    given = world.tick()
    wanted = every_pose(world)
    if given is None or wanted is None:
        assert given is wanted
        return False
    assert given.clearance == pytest.approx(wanted.clearance, abs=1e-6)
    assert given.clearance == inf or given.pair == wanted.pair
    return given.clearance < inf


@pytest.mark.parametrize(("robot", "seeds"), [("arm", range(12)), ("h24", range(5))])
def test_each_tick_reports_what_it_would_with_every_pose_measured(
    tmp_path: Path, robot: str, seeds: range
) -> None:
    """Paths that are replaced and slowed, and streams: nothing is reported later, or not at all."""
    binding = arm(tmp_path, OPEN) if robot == "arm" else h24()
    near = 0
    for seed in seeds:
        world = World(binding)
        random = np.random.default_rng(seed)
        limits = binding.limits
        start = np.array(binding.rest)
        joints = np.arange(len(start))
        for _ in range(5):
            share = random.uniform(0.3, 1.0)
            to = start + share * (random.uniform(limits.lower, limits.upper) - start)
            if robot == "arm":  # the elbow folds the tip towards the base
                to[1] = random.uniform(1.8, 2.9)
            if random.random() < 0.3:
                for _ in range(30):
                    world.executor.setpoint(joints, to, None, 0.1)
                    near += same_report(world)
                continue
            seconds = float(random.uniform(0.8, 2.0))
            world.executor.submit("a", Trajectory(np.array([seconds]), to[None], joints >= 0))
            for tick in range(int(random.integers(20, 120))):
                world.executor.pace = 0.5 if 25 <= tick < 35 else 1.0
                near += same_report(world)
    assert near > 20


# --------------------------------------------------------------------------- streams


def chase(world: World, goals: np.ndarray) -> tuple[int, float]:
    """Stream `goals` (k, n), one a tick, as the loop does; how many were refused, least clearance - block."""
    joints = np.arange(goals.shape[1])
    least = inf
    refused = 0
    for goal in goals:
        if world.look.refuses(world.executor, joints, goal, None):
            refused += 1
        else:
            world.executor.setpoint(joints, goal, None, 0.1)
        outlook = world.tick()
        if outlook is not None and not outlook.clearance > outlook.block:
            world.executor.stop()
        least = min(least, world.clearance())
    world.executor.stop()
    for _ in range(60):
        world.tick()
        least = min(least, world.clearance())
    return refused, least


def test_a_stream_into_itself_stops_before_it(world: World) -> None:
    refused, least = chase(world, np.tile([0.0, 2.9, 0.0], (300, 1)))
    assert refused > 0
    assert least > 0.0


@pytest.mark.parametrize("speed", [0.2, 0.02, 0.005])
def test_a_stream_that_creeps_into_itself_stops_before_it_and_may_return(world: World, speed: float) -> None:
    world.executor.begin(np.array([0.0, 2.6, 0.0]))
    assert world.clearance() > 0.0
    place = 2.6
    while world.clearance() > 1e-3:  # near, without a tick in which anything moves
        place += 0.002
        world.executor.begin(np.array([0.0, place, 0.0]))
    ticks = round(0.03 / (speed * PERIOD))
    goals = np.zeros((ticks, 3))
    goals[:, 1] = place + speed * PERIOD * np.arange(ticks)
    refused, least = chase(world, goals)
    assert refused > 0
    assert least > -1.5e-4
    goals[:, 1] = np.linspace(place, 2.6, ticks)
    assert chase(world, goals)[0] == 0


@pytest.mark.parametrize("speed", [0.5, 1.0, 2.0])
def test_an_older_path_beside_a_stream_stops_clear_too(world: World, speed: float) -> None:
    path = Trajectory(np.array([2.9 / speed]), np.array([[0.0, 2.9, 0.0]]), np.array([True, True, False]))
    assert world.executor.submit("a", path) is None
    world.tick()
    least = inf
    for _ in range(round(2.9 / speed / PERIOD) + 60):
        if world.executor.motion is not Motion.HOLDING:
            world.executor.setpoint(np.array([2]), np.zeros(1), None, 0.1)
        outlook = world.tick()
        if outlook is not None and not outlook.clearance > outlook.block:
            world.executor.stop()
        least = min(least, world.clearance())
    assert world.executor.motion is Motion.HOLDING
    assert 0.0 < least < 0.01


def test_a_reversing_setpoint_stream_can_always_stop_clear(tmp_path: Path) -> None:
    """Away and back at the worst moments: whatever was taken, braking from there was clear."""
    for seed in range(3):
        world = World(arm(tmp_path, OPEN))
        random = np.random.default_rng(seed)
        goals = np.zeros((400, 3))
        for start in range(0, 400, 20):
            goals[start : start + 20, 1] = random.uniform(1.8, 2.9)
            goals[start : start + 20, 2] = random.uniform(-0.5, 0.5)
        _, least = chase(world, goals)
        assert least > 0.0


def test_a_whole_humanoid_streamed_at_random_never_touches_itself() -> None:
    world = World(h24())
    random = np.random.default_rng(2)
    limits = world.binding.limits
    arms = [
        name.startswith(("l_shoulder", "l_elbow", "r_shoulder", "r_elbow"))
        for name in world.binding.robot.names
    ]
    goals = np.repeat(random.uniform(limits.lower, limits.upper, (25, 24)), 12, axis=0) * np.array(arms)
    refused, least = chase(world, goals)
    assert refused > 0
    assert least > 0.0


# --------------------------------------------------------------------------- the way itself


def test_braking_is_where_a_ramp_goes(world: World) -> None:
    reference = Reference(np.zeros(3), np.array([1.0, -1.5, 0.0]), np.zeros(3))
    ramp = StopRamp(reference, world.binding.limits, PERIOD)
    times = np.array([0.0, 0.05, 0.1, 0.5])
    found = braking(reference, world.binding.limits, times)
    assert found == pytest.approx(np.array([ramp.reference_at(t).position for t in times]))


def test_along_is_where_the_curve_is() -> None:
    path = Trajectory(
        np.array([0.5, 1.0]), np.array([[1.0], [0.3]]), np.ones(1, np.bool_), np.array([[0.4], [0.0]])
    )
    still = Reference(np.zeros(1), np.zeros(1), np.zeros(1))
    curve = interpolate(path, still)
    times = np.linspace(0.0, 1.3, 27)
    assert along(curve, times) == pytest.approx(np.array([at(curve, t) for t in times]))
    assert along(hold(np.ones(2)), times).shape == (27, 2)


def test_the_course_of_layers_is_what_the_executor_does(world: World) -> None:
    """A goal that leaves joints to an older one: what was foreseen is what comes."""
    elbow(world, 1.0, 1.0)
    for _ in range(20):
        world.tick()
    wrist = np.array([False, False, True])
    world.executor.submit("b", Trajectory(np.array([0.8]), np.array([[0.0, 0.0, 0.4]]), wrist))
    world.tick()
    plan = world.executor.plan
    assert plan is not None
    foreseen = plan.course(world.binding.limits, np.arange(1, 31) * PERIOD)
    for row in foreseen:
        world.tick()
        assert world.executor.reference is not None
        assert world.executor.reference.position == pytest.approx(row, abs=1e-9)


# --------------------------------------------------------------------------- in the loop


INTO_ITSELF = {"l_elbow": -1.5, "l_shoulder_yaw": -1.4}  # the left forearm into the chest


@pytest.fixture
def rig(make_rig: MakeRig) -> Rig:
    made: Rig = make_rig(mode=Mode.SIM)
    made.ticks(5)
    made.call(link.AcquireLease)
    return made


def clearance(rig: Rig, bodies: CollisionModel) -> float:
    oracle = Oracle(rig.one.binding, [pair.geoms for pair in bodies.pairs])
    return float((oracle.row(rig.loop.executor.reference.position) - bodies.block).min())


def test_a_setpoint_into_the_robot_itself_is_refused_by_the_loop(rig: Rig) -> None:
    bodies = CollisionModel(rig.one.binding)
    joints = [rig.names.index(name) for name in INTO_ITSELF]
    refused: list[str] = []
    for _ in range(300):
        reply = rig.call(link.Setpoint, joints=joints, positions=list(INTO_ITSELF.values()), ticks=3)
        refused += [finding["code"] for finding in reply.parameters.get("findings", ())]
        assert clearance(rig, bodies) > 0.0
        if refused:
            break
    assert refused == ["SELF_COLLISION"]


@pytest.mark.parametrize("mode", [Mode.SIM, Mode.MIRROR])
def test_a_self_colliding_path_without_a_gate_refusal_is_held_before_contact(
    make_rig: MakeRig, mode: Mode
) -> None:
    """Without the front's verdict: the second guard alone."""
    rig = make_rig(mode=mode)
    rig.ticks(5)
    rig.call(link.AcquireLease)
    bodies = CollisionModel(rig.one.binding)
    end = np.array([INTO_ITSELF.get(name, 0.0) for name in rig.names])
    path = Trajectory(np.array([3.0]), end[None], np.ones(24, np.bool_))
    rig.submit(path, policy="retime")
    least = inf
    for _ in range(350):
        rig.ticks(1)
        rig.send(link.RenewLease)
        if rig.loop.executor.reference is not None:
            least = min(least, clearance(rig, bodies))
    assert rig.events("LOOKAHEAD_COLLISION")
    assert rig.loop.executor.motion is Motion.HOLDING
    assert 0.0 < least < 0.03
