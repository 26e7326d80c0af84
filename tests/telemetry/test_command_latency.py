"""The way of a command: every hop once, and no figure of what did not happen."""

from dataclasses import replace
from math import inf, isnan, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.robot.joint_state import JointState
from twind.robot.trajectory import Reference
from twind.safety.latency_alarm import LatencyAlert
from twind.telemetry.command_latency import STREAM, CommandLatencyTracer
from twind.telemetry.timing_monitor import COMMAND, TimingMonitor

# rad, rad/s, s: as docs/reason-codes.md says
VISIBLE = 0.005
STILL = 0.05
PATIENCE = 1.0
# Powers of two, so that sums of them are exact.
# s
TICK = 2.0**-7
ANSWER = 2.0**-8
# s
CALLED = 2.0**-8
JUDGING = 2.0**-10
WAITING = 2.0**-11
FAR = 2.0 * VISIBLE
BOTH = np.array([True, True])


class World:
    """Two joints that stand; time is the test's."""

    def __init__(self, begin: tuple[float, float] = (1.0, -1.0)) -> None:
        self.health = TimingMonitor(1)
        self.way = CommandLatencyTracer(self.health)
        self.now = 10.0
        self.begin = np.array(begin)
        self.state = JointState(
            self.now, self.begin, np.zeros(2), np.zeros(2), np.zeros(2), np.ones(2, np.bool_), 0.0
        )

    def command(self, id: str = "t", *, speed: float = 0.0, joints: np.ndarray = BOTH) -> None:
        """Called a little ago, judged, accepted."""
        taken = self.way.take(self.now - CALLED, self.now)
        self.now += JUDGING
        self.way.judge(taken, self.now)
        before = Reference(self.begin, np.array([speed, 0.0]), np.zeros(2))
        self.way.accept(taken, id, joints, before, self.now)
        self.now += WAITING

    def tick(self, goal: list[float] | None, moved: list[float] | None = None) -> None:
        """A goal so far from where it began (None: none leaves), then a reading so far, a little later."""
        if goal is None:
            self.way.silence()
        else:
            self.way.write(self.begin + goal, self.now, self.state)
        place = self.state.position if moved is None else self.begin + moved
        self.state = replace(self.state, position=place)
        self.way.look(self.state, self.now + ANSWER)
        self.now += TICK

    def counts(self) -> dict[str, int]:
        """Return the number of figures of each hop."""
        return {name: self.health.hops[name].count for name in COMMAND if self.health.hops[name].count}

    def last(self, hop: str) -> float:
        return self.health.hops[hop].now


ON_ITS_WAY = {"received": 1, "gated": 1, "written": 1, "command": 1}
WHOLE = {"received": 1, "gated": 1, "written": 1, "moved": 1, "command": 1}


def test_every_hop_of_a_command_is_measured_once() -> None:
    world = World()
    world.command()
    world.tick([FAR / 4, 0.0])
    world.tick([FAR, 0.0])  # from here a move is asked for that can be seen
    world.tick([FAR, 0.0], [FAR / 4, 0.0])
    world.tick([FAR, 0.0], [FAR, 0.0])
    world.tick([FAR, 0.0], [FAR, 0.0])
    assert world.counts() == WHOLE
    assert world.last("received") == CALLED
    assert world.last("gated") == JUDGING
    assert world.last("written") == WAITING
    assert world.last("command") == CALLED + JUDGING + WAITING
    assert world.last("moved") == 2 * TICK + ANSWER


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("joint", [0, 1])
def test_a_joint_has_moved_when_it_moved_far_enough_in_the_commanded_direction(
    joint: int, side: float
) -> None:
    world = World()
    world.command()
    ask = np.zeros(2)
    ask[joint] = side * VISIBLE * 1.000001
    world.tick(ask.tolist(), (-3.0 * ask).tolist())
    world.tick(ask.tolist(), (0.99 * ask).tolist())
    assert world.counts() == ON_ITS_WAY
    world.tick(ask.tolist(), ask.tolist())
    assert world.counts() == WHOLE


def test_motion_is_measured_on_the_joint_with_the_largest_visible_command() -> None:
    world = World()
    world.command()
    world.tick([VISIBLE * 0.999999, 0.0], [FAR, 0.0])
    assert world.counts() == ON_ITS_WAY
    world = World()
    world.command()
    world.tick([FAR, 2.0 * FAR])
    world.tick([FAR, 2.0 * FAR], [FAR, 0.0])
    assert world.counts() == ON_ITS_WAY
    world.tick([FAR, 2.0 * FAR], [FAR, FAR])
    assert world.counts() == WHOLE


# ------------------------------------------------------------------------------------- no figure


def test_a_refused_command_has_only_the_figures_of_its_check() -> None:
    world = World()
    world.way.judge(world.way.take(world.now - 0.003, world.now), world.now + 0.001)
    world.tick([FAR, 0.0], [FAR, 0.0])
    assert world.counts() == {"received": 1, "gated": 1}


def test_a_command_ended_before_its_first_goal_has_no_motion_figures() -> None:
    world = World()
    world.command("t")
    world.way.end("another")
    world.way.end("t")
    world.tick([FAR, 0.0], [FAR, 0.0])
    assert world.counts() == {"received": 1, "gated": 1}
    world.command("t")
    world.way.end("another")
    world.tick([FAR, 0.0])
    assert world.counts()["written"] == 1


def test_a_command_replaced_before_its_first_goal_has_no_motion_figures() -> None:
    world = World()
    world.command("one")
    world.now += 0.5
    world.command("two")
    world.tick([FAR, 0.0])
    assert world.counts() == ON_ITS_WAY | {"received": 2, "gated": 2}
    assert world.last("command") == CALLED + JUDGING + WAITING


def test_while_no_goal_leaves_it_is_waited_and_the_wait_counts() -> None:
    world = World()
    world.command()
    for _ in range(3):
        world.tick(None)
    assert "written" not in world.counts()
    world.tick([0.0, 0.0])
    assert world.last("written") == 3 * TICK + WAITING


def test_a_joint_that_never_moves_has_no_figure_and_later_moves_are_not_its() -> None:
    world = World()
    world.command()
    for _ in range(round(PATIENCE / TICK) + 1):
        world.tick([FAR, 0.0])
    world.tick([FAR, 0.0], [FAR, 0.0])
    assert world.counts() == ON_ITS_WAY


@pytest.mark.parametrize(("late", "moved"), [(0.0, 1), (TICK, 0)])
def test_a_motion_not_seen_within_the_patience_is_given_up(late: float, moved: int) -> None:
    world = World()
    world.command()
    world.tick([FAR, 0.0])
    world.now += PATIENCE - ANSWER - TICK + late
    world.tick([FAR, 0.0])  # looked at, to the bit, so much after it was asked
    world.tick([FAR, 0.0], [FAR, 0.0])
    assert world.counts().get("moved", 0) == moved


@pytest.mark.parametrize(("wait", "moved"), [(PATIENCE, 1), (PATIENCE + TICK, 0)])
def test_a_command_without_a_visible_motion_is_not_waited_for_indefinitely(wait: float, moved: int) -> None:
    world = World()
    world.command()
    world.tick([0.0, 0.0])
    world.now += wait - TICK
    world.tick([0.0, 0.0])
    world.tick([FAR, 0.0])
    world.tick([FAR, 0.0], [FAR, 0.0])
    assert world.counts() == (WHOLE if moved else ON_ITS_WAY)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_visible_move_is_this_far_and_no_less(side: float) -> None:
    below = float(np.nextafter(VISIBLE, 0.0))
    for asked, gone, moved in ((VISIBLE, VISIBLE, 1), (below, VISIBLE, 0), (VISIBLE, below, 0)):
        world = World(begin=(0.0, 0.0))
        world.command()
        world.tick([side * asked, 0.0])
        world.tick([side * asked, 0.0], [side * gone, 0.0])
        assert world.counts().get("moved", 0) == moved


def test_a_command_whose_goals_reverse_has_no_motion_figure() -> None:
    world = World()
    world.command()
    world.tick([FAR, 0.0])
    world.tick([0.0, 0.0])
    world.tick([0.0, 0.0], [FAR, 0.0])
    assert world.counts() == ON_ITS_WAY


def test_a_joint_that_falls_after_torque_off_has_no_motion_figure() -> None:
    world = World()
    world.command()
    world.tick([FAR, 0.0])
    world.tick(None, [FAR, 0.0])
    world.tick([FAR, 0.0], [FAR, 0.0])
    assert world.counts() == ON_ITS_WAY


def test_in_another_mode_it_is_another_robot() -> None:
    world = World()
    world.command()
    world.way.forget()
    world.tick([FAR, 0.0])
    assert "written" not in world.counts()
    world.command()
    world.tick([FAR, 0.0])
    world.way.forget()
    world.tick([FAR, 0.0], [FAR, 0.0])
    assert "moved" not in world.counts()


def test_a_motion_before_its_command_has_no_figure() -> None:
    world = World()
    world.command()
    world.tick([0.0, 0.0], [FAR, 0.0])
    world.tick([FAR, 0.0], [FAR, 0.0])
    world.tick([FAR, 0.0], [FAR, 0.0])
    assert world.counts() == ON_ITS_WAY


@pytest.mark.parametrize("what", ["reference", "reading", "unheard", "not commanded", "unknown"])
def test_only_resting_commanded_and_fresh_joints_are_measured(what: str) -> None:
    world = World()
    fast = np.array([1.000001 * STILL, 0.0])
    if what == "reading":
        world.state = replace(world.state, velocity=-fast)
    if what == "unknown":
        world.state = replace(world.state, velocity=np.array([nan, 0.0]))
    if what == "unheard":
        world.state = replace(world.state, heard=np.array([False, True]))
    joints = np.array([False, True]) if what == "not commanded" else BOTH
    world.command(speed=-1.000001 * STILL if what == "reference" else 0.0, joints=joints)
    world.tick([FAR, 0.0])
    world.tick([FAR, 0.0], [FAR, 0.0])
    assert world.counts() == ON_ITS_WAY
    world.tick([FAR, FAR], [FAR, 0.0])  # the other one is
    world.tick([FAR, FAR], [FAR, FAR])
    assert world.counts() == WHOLE


def test_motion_is_measured_only_on_joints_below_the_rest_speed() -> None:
    world = World()
    world.state = replace(world.state, velocity=np.array([-STILL, STILL]))
    world.command(speed=-STILL)
    world.tick([FAR, 0.0])
    world.tick([FAR, 0.0], [FAR, 0.0])
    assert world.counts() == WHOLE
    world = World()
    world.command(joints=~BOTH)
    world.tick([FAR, FAR])
    world.tick([FAR, FAR], [FAR, FAR])
    assert world.counts() == ON_ITS_WAY


# ------------------------------------------------------------------------------------- one after another


def test_a_trajectory_that_replaces_one_takes_the_look_over() -> None:
    world = World()
    world.command("one")
    world.tick([FAR, 0.0])
    world.command("two")
    world.tick([0.0, FAR], [FAR, 0.0])
    assert "moved" not in world.counts()
    world.tick([0.0, FAR], [FAR, FAR])
    assert world.counts()["moved"] == 1


def test_only_the_start_of_a_setpoint_stream_has_a_motion_figure() -> None:
    world = World()
    for step in range(1, 6):
        world.command(STREAM)
        world.tick([step * 0.6 * VISIBLE, 0.0])
    world.command(STREAM)
    world.tick([4.0 * VISIBLE, 0.0], [1.1 * VISIBLE, 0.0])
    assert world.counts() == {"received": 6, "gated": 6, "written": 6, "moved": 1, "command": 6}
    assert world.last("moved") == 4 * (TICK + JUDGING + WAITING) + ANSWER


# ------------------------------------------------------------------------------------- wrong times, bounds


@pytest.mark.parametrize("received", [None, nan, inf, 11.0])
def test_a_call_with_an_unknown_time_is_a_violation_and_in_no_average(
    received: float | None,
) -> None:
    world = World()
    taken = world.way.take(received, world.now, bound=inf)
    world.way.accept(taken, "t", BOTH, Reference(world.begin, np.zeros(2), np.zeros(2)), world.now)
    world.tick([0.0, 0.0])
    for hop in ("received", "command"):
        window = world.health.hops[hop]
        assert (window.violations, window.buckets[-1], window.sum) == (1, 1, 0.0)
        assert isnan(window.now)
        assert isnan(window.mean)
    assert world.health.hops["written"].violations == 0


def test_a_long_path_is_judged_long_and_only_a_setpoint_is_late_for_it() -> None:
    for bound, violations in ((inf, 0), (None, 1)):
        world = World()
        taken = world.way.take(world.now - 0.3, world.now, bound)
        world.way.judge(taken, world.now + 0.3)
        world.now += 0.3
        world.way.accept(taken, "t", BOTH, Reference(world.begin, np.zeros(2), np.zeros(2)), world.now)
        world.tick([0.0, 0.0])
        for hop in ("received", "gated", "command"):
            assert world.health.hops[hop].violations == violations
        assert [alert.hop for alert in world.health.alerts()] == ["received", "gated", "command"][
            : 3 * violations
        ]


def test_a_late_goal_is_reported_for_any_command() -> None:
    world = World()
    taken = world.way.take(world.now, world.now, inf)
    world.way.accept(taken, "t", BOTH, Reference(world.begin, np.zeros(2), np.zeros(2)), world.now)
    world.now += 0.06
    world.tick([0.0, 0.0])
    assert world.health.alerts() == [LatencyAlert("written", pytest.approx(0.06), 0.05)]


# ------------------------------------------------------------------------------------- whatever happens

events = st.sampled_from(
    ["one", "two", STREAM, "end one", "end stream", "forget", "goal", "goal", "goal", "silence"]
)


@given(st.lists(st.tuples(events, st.floats(-0.03, 0.03), st.floats(-0.03, 0.03)), max_size=60))
def test_no_hop_has_more_figures_than_the_hop_before_it(happens: list) -> None:
    world = World()
    gated = 0
    for event, goal, moved in happens:
        if event in ("one", "two", STREAM):
            world.command(event)
            gated += 1
        elif event.startswith("end"):
            world.way.end("one" if event == "end one" else STREAM)
        elif event == "forget":
            world.way.forget()
        else:
            world.tick(None if event == "silence" else [goal, 0.0], [moved, 0.0])
    told = {name: world.health.hops[name].count for name in COMMAND}
    assert told["received"] == told["gated"] == gated
    assert gated >= told["written"] == told["command"] >= told["moved"]
    for hop in COMMAND:
        window = world.health.hops[hop]
        assert sum(window.buckets) == window.count
        assert not window.count or window.min >= 0.0
