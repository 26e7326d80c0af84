"""The monitor itself: each rule dense around its edge, and what it makes of late words."""

from pathlib import Path

import numpy as np
import pytest

from tests.proof.busmon import packet
from tests.proof.busmon.monitor import Monitor
from tests.proof.busmon.shadow import Servos
from tests.proof.busmon.words import GOALS, STATES
from tests.proof.evil import world
from tests.proof.evil.good import Good

LIMITS = world.limits()


# ------------------------------------------------------------------------------------------- edges


class Armed(Good):
    """The right daemon, armed and holding."""

    def __init__(self, **options: float) -> None:
        self.world = world.VirtualPort(LIMITS)
        super().__init__(self.world, LIMITS)
        self.connect()
        self.arm()
        self.hold(3)
        assert not self.rules

    def run(self) -> None:
        """The first joint in full motion."""
        speed = int(LIMITS.servos[1].speed * LIMITS.period)
        for _ in range(12):
            self.cycle(self.goals | {1: self.goals[1] - speed})

    def estop(self) -> None:
        self.port.say("estop", level="settle")
        self.port.say("state", state="estop")

    @property
    def rules(self) -> list[str]:
        return [violation.rule for violation in self.world.monitor.violations]


@pytest.mark.parametrize("place", range(3))
@pytest.mark.parametrize("more", range(-3, 4))
@pytest.mark.parametrize("way", [-1, 1])
def test_a_step_is_judged_to_the_count(place: int, more: int, way: int) -> None:
    daemon = Armed()
    id = daemon.ids[place]
    most = int(LIMITS.servos[id].speed * LIMITS.period + 1)
    daemon.cycle(daemon.goals | {id: daemon.goals[id] + way * (most + more)})
    assert daemon.rules == (["W3"] if more > 0 else [])


@pytest.mark.parametrize("beyond", range(-2, 3))
@pytest.mark.parametrize("end", ["lower", "upper"])
def test_a_goal_is_judged_to_the_count(beyond: int, end: str) -> None:
    servo = LIMITS.servos[1]
    goal = servo.upper + beyond if end == "upper" else servo.lower - beyond
    daemon = Armed()
    daemon.world.monitor.servos.goal[:] = [goal, *daemon.world.monitor.servos.goal[1:]]
    daemon.goals[1] = goal
    daemon.cycle(dict(daemon.goals))
    assert daemon.rules == (["W1"] if beyond > 0 else [])


@pytest.mark.parametrize("off", range(-4, 5))
def test_the_goal_at_torque_on_may_be_two_counts_from_where_the_servo_was_read(off: int) -> None:
    class Off(Good):
        def place(self) -> None:
            super().place()
            self.goals = {id: goal + off for id, goal in self.goals.items()}
            self.port.write(self.aim(self.goals))
            self.wait()

    port = world.VirtualPort(LIMITS)
    daemon = Off(port, LIMITS)
    daemon.connect()
    daemon.arm()
    assert {violation.rule for violation in port.monitor.violations} == ({"W4"} if abs(off) > 2 else set())


@pytest.mark.parametrize(("age", "old"), [(0.04, False), (0.049, False), (0.0501, True), (0.06, True)])
def test_a_position_is_good_for_a_goal_for_50_ms(age: float, old: bool) -> None:
    port = world.VirtualPort(LIMITS)
    daemon = Good(port, LIMITS)
    daemon.connect()
    port.say("state", state="arming")
    daemon.cycle()
    read = port.monitor.servos.seen[-1][0]
    port.until(read + age)
    port.write(daemon.aim(daemon.present()))
    assert [violation.rule for violation in port.monitor.violations] == (["W4"] * 3 if old else [])


@pytest.mark.parametrize("state", STATES)
def test_goals_leave_in_states_that_move_and_torque_goes_on_in_one(state: str) -> None:
    port = world.VirtualPort(LIMITS)
    daemon = Good(port, LIMITS)
    daemon.connect()
    daemon.guard()
    before = len(port.monitor.violations)
    port.say("state", state=state)
    port.write(daemon.aim(daemon.present()))
    found = [violation.rule for violation in port.monitor.violations[before:]]
    assert found == ([] if state in GOALS else ["W5"])
    before = len(port.monitor.violations)
    port.write(packet.make(1, 0x03, bytes.fromhex("40 00 01")))
    found = [violation.rule for violation in port.monitor.violations[before:] if violation.rule == "W5"]
    assert found == ([] if state == "arming" else ["W5"])


@pytest.mark.parametrize("state", STATES)
def test_eeprom_and_restarts_need_a_robot_at_rest_and_torque_read_off(state: str) -> None:
    written = packet.make(1, 0x03, bytes.fromhex("1f 00 50"))
    restart = packet.make(1, 0x08)
    restarts = ("connected", "calibrating", "identifying")
    for data, states in ((written, ("calibrating",)), (restart, restarts)):
        port = world.VirtualPort(LIMITS)
        daemon = Good(port, LIMITS)
        daemon.connect()
        port.say("state", state=state)
        port.write(data)
        wanted = [] if state in states else ["W2"]
        assert [violation.rule for violation in port.monitor.violations] == wanted
        unread = Monitor(LIMITS)
        unread.take_report("state", 0.0, state=state)
        unread.sent(data, 0.0)
        assert [violation.rule for violation in unread.violations] == ["W2"]


@pytest.mark.parametrize(("pause", "caught"), [(0.05, False), (0.0599, False), (0.0601, True), (0.1, True)])
@pytest.mark.parametrize("holds", [True, False])
def test_silence_is_judged_at_60_ms_and_forgiven_to_who_holds(
    pause: float, caught: bool, holds: bool
) -> None:
    daemon = Armed()
    for _ in range(10):
        daemon.cycle({id: goal - 5 for id, goal in daemon.goals.items()})
    monitor = daemon.world.monitor
    last = monitor.packet_at
    daemon.port.until(last + pause)
    daemon.tick = daemon.port.now
    for _ in range(90):  # longer than the longest braking
        daemon.cycle({id: goal + (0 if holds else 4) for id, goal in daemon.goals.items()})
    assert daemon.rules == (["W7"] if caught and not holds else [])


@pytest.mark.parametrize(("value", "good"), [(0, False), (1, True), (5, True), (6, False), (127, False)])
def test_a_watchdog_of_20_to_100_ms_is_one(value: int, good: bool) -> None:
    class Other(Good):
        def guard(self) -> None:
            self.goals = self.present()
            guard = self.all(98, bytes((value,)))
            self.port.write(self.all(98, b"\0") + self.aim(self.goals) + guard)
            self.wait()

        def prove(self) -> None:
            self.ask(98, 1)
            self.wait()

    port = world.VirtualPort(LIMITS)
    daemon = Other(port, LIMITS)
    daemon.connect()
    daemon.arm()
    assert ("W7" in {violation.rule for violation in port.monitor.violations}) is not good


def test_reports_may_arrive_later_than_bytes_up_to_the_bound() -> None:
    for late, wrong in ((0.09, False), (0.11, True)):
        port = world.VirtualPort(LIMITS)
        port.monitor = Monitor(LIMITS, hearsay=0.1)
        daemon = Good(port, LIMITS)
        daemon.connect()
        daemon.cycle()
        began = port.now
        port.write(daemon.aim(daemon.present()))
        while port.now < began + late:
            daemon.cycle()
        port.monitor.take_report("state", began + late, state="arming")
        port.monitor.look(began + 1.0)
        assert ("W5" in {each.rule for each in port.monitor.violations}) is wrong


def test_an_unknown_report_raises_an_error() -> None:
    monitor = Monitor(LIMITS)
    for what, facts in (("weather", {}), ("state", {"state": "asleep"}), ("mode", {"mode": "fast"})):
        with pytest.raises(ValueError, match="known:"):
            monitor.take_report(what, 0.0, **facts)


def test_the_last_packets_can_be_printed() -> None:
    daemon = Armed()
    lines = [str(seen) for seen in daemon.world.monitor.last]
    assert len(lines) <= 200
    assert any(" > ff ff fd 00 fe" in line for line in lines)
    assert any(" < ff ff fd 00 fe" in line for line in lines)


def test_limits_that_make_no_sense_are_refused(tmp_path: Path) -> None:
    robot, calibration = world.files(tmp_path)
    text = robot.read_text()
    measured = calibration.read_text()
    for file, old, new in (
        (robot, "XM430-W350", "PH54-200-S500-R"),
        (robot, "sign: -1", "sign: 2"),
        (robot, "velocity_limit_rad_s: 4.0", "velocity_limit_rad_s: .nan"),
        (robot, "rate_hz: 100", "rate_hz: 0"),
        (robot, "id: 2,", "id: 1,"),
        (robot, "limits_rad: [-1.0, 0.5]", "limits_rad: [0.5, -1.0]"),
        (calibration, "zero_ticks: 2048", "zero_ticks: 9000"),
        (calibration, "id: 5", "id: 6"),
    ):
        robot.write_text(text)
        calibration.write_text(measured)
        assert old in file.read_text(), old
        file.write_text(file.read_text().replace(old, new, 1))
        with pytest.raises((ValueError, KeyError)):
            world.Limits.read(robot, calibration, "main")
    with pytest.raises(ValueError, match="no servo"):
        world.Limits.read(*world.files(tmp_path), "arm")


def test_ranges_and_speeds_are_those_of_the_geared_joint() -> None:
    servo = LIMITS.servos[2]  # ratio 2, sign -1, zero 2200
    each = np.pi / 4096
    assert servo.lower == 2200 - int(0.75 / each)
    assert servo.upper == 2200 + int(0.75 / each)
    assert servo.speed == pytest.approx(1.5 / each)
    assert servo.brake == pytest.approx(10.0 / each)


def test_late_words_that_carry_their_time_excuse_nothing_that_came_before_them() -> None:
    for left, at, wrong in ((1.0, 1.0, False), (1.0, 0.9, False), (1.0, 1.004, False), (1.0, 1.02, True)):
        monitor = Monitor(LIMITS, hearsay=0.5)
        monitor.sent(packet.make(1, 0x03, bytes.fromhex("74 00 34 08 00 00")), left)
        monitor.take_report("state", 1.1, state="arming", at=at)
        monitor.look(3.0)
        assert ("W5" in {each.rule for each in monitor.violations}) is wrong, at


def test_a_goal_that_left_after_the_robot_was_disarmed_is_found_when_the_word_comes() -> None:
    for left, wrong in ((1.0, False), (1.005, False), (1.02, True)):
        monitor = Monitor(LIMITS, hearsay=0.5)
        monitor.take_report("state", 0.5, state="armed", at=0.5)
        monitor.sent(packet.make(1, 0x03, bytes.fromhex("74 00 34 08 00 00")), left)
        monitor.take_report("state", 1.1, state="connected", at=1.0)
        assert ("W5" in {each.rule for each in monitor.violations}) is wrong, left


@pytest.mark.parametrize(
    ("velocity", "delay", "wrong"),
    [(0.0, 0.1, 0), (1.0, 0.12, 0), (1.5, 0.1, 1), (0.0, 0.1201, 1), (0.0, None, 1), (float("nan"), 0.1, 1)],
)
def test_after_a_kill_servos_have_tripped_in_time_and_rest(
    velocity: float, delay: float | None, wrong: int
) -> None:
    daemon = Armed()
    daemon.port.say("servos", velocity={1: 50.0}, trip_delay={1: None})  # nobody was killed yet
    assert not daemon.rules
    daemon.port.say("killed")
    daemon.port.until(daemon.port.now + 0.125)
    daemon.port.say("servos", velocity={1: velocity}, trip_delay={1: delay})
    assert daemon.rules == ["W11"] * wrong


@pytest.mark.parametrize(("lasts", "wrong"), [(7.9, False), (8.4, True)])
def test_a_robot_that_is_damped_has_five_more_seconds_to_let_go(lasts: float, wrong: bool) -> None:
    daemon = Armed()
    daemon.estop()
    daemon.hold(300)
    daemon.port.say("damp")
    daemon.hold(round((lasts - 3.0) * 100))
    daemon.loosen()
    assert daemon.rules == (["W6"] if wrong else [])


@pytest.mark.parametrize(("share", "early", "wrong"), [(0.0, 1, True), (1e-4, 3, False), (1e-4, 4, True)])
def test_a_share_of_packets_may_seem_early_where_a_port_may_keep_bytes(
    share: float, early: int, wrong: bool
) -> None:
    daemon = Armed()
    monitor = daemon.world.monitor
    monitor.early_share = share
    question = packet.make(254, 0x82, bytes.fromhex("84 00 04 00") + bytes(daemon.ids))
    for _ in range(early):
        monitor.sent(question, daemon.port.now)
        monitor.sent(question, daemon.port.now + 1e-5)
        daemon.wait()
    assert (daemon.rules == ["W9"]) is wrong


@pytest.mark.parametrize("damped", [True, False])
def test_the_goals_of_a_robot_that_sinks_already_follow_it_through_an_e_stop(damped: bool) -> None:
    daemon = Armed()
    daemon.port.say("state", state="fault")
    if damped:
        daemon.port.say("damp")
    daemon.estop()
    for _ in range(5):
        daemon.cycle(daemon.goals | {1: daemon.goals[1] - 5})
    assert set(daemon.rules) == (set() if damped else {"W6"})


@pytest.mark.parametrize(("hardness", "wrong"), [(0.9, False), (2.0, True)])
def test_a_joint_that_braked_early_is_lowered_from_rest_within_its_acceleration(
    hardness: float, wrong: bool
) -> None:
    """On its way again while a slower stop would still brake."""
    daemon = Armed()
    daemon.run()
    daemon.estop()
    daemon.hold(3)  # packets, of 42 in which braking is watched
    place = float(daemon.goals[1])
    step = hardness * LIMITS.servos[1].brake * LIMITS.period**2
    for number in range(1, 11):
        place += number * step
        daemon.cycle(daemon.goals | {1: round(place)})
    assert set(daemon.rules) <= {"W6"}
    assert bool(daemon.rules) is wrong


def aim_anew(daemon: Armed, goals: dict[int, int], *, cleared: bool) -> None:
    """Goals in one call with watchdogs that are cleared and set, as after a trip; or without."""
    before, after = (daemon.all(98, b"\0"), daemon.all(98, b"\5")) if cleared else (b"", b"")
    daemon.port.write(before + daemon.aim(goals) + after)
    daemon.cycle()


@pytest.mark.parametrize("off", range(-4, 5))
@pytest.mark.parametrize("cleared", [True, False])
def test_a_servo_that_dropped_its_goal_is_stopped_where_it_is_and_nowhere_else(
    cleared: bool, off: int
) -> None:
    """In full motion the goal leads the shaft by far: back to it is no braking, but for who tripped."""
    daemon = Armed()
    most = int(LIMITS.servos[1].speed * LIMITS.period)
    daemon.run()
    assert daemon.here[1] - daemon.goals[1] > 3 * most
    daemon.estop()
    aim_anew(daemon, daemon.goals | {1: daemon.here[1] + off}, cleared=cleared)
    assert set(daemon.rules) == ((set() if abs(off) <= 2 else {"W3", "W6"}) if cleared else {"W3", "W6"})


@pytest.mark.parametrize("off", range(-4, 5))
def test_the_step_of_a_servo_that_dropped_its_goal_counts_from_its_reading(off: int) -> None:
    """To the count: a goal that creeps ahead of the shaft in every packet is no stop."""
    servos = Servos(LIMITS)
    servos.aim(1.0, np.array([2000, 2000, 2000]))
    servos.at(1.0, servos.all, np.array([2100, 2100, 2003]))
    servos.aim(1.01, np.array([2100 + off, 1990, 2001]))
    servos.aimed_anew([0, 2], 1.01)
    _, _, moves = servos.goals[-1]
    assert moves.tolist() == [off if abs(off) <= 2 else 100 + off, -10, 1]


@pytest.mark.parametrize(("pause", "wrong"), [(0.0, False), (0.049, False), (0.051, True)])
def test_the_rest_of_a_packet_may_take_50_ms(pause: float, wrong: bool) -> None:
    monitor = Monitor(LIMITS)
    ping = packet.make(1, 0x01)
    monitor.sent(ping[:4], 10.0)
    monitor.sent(ping[4:7], 10.0 + pause / 2)
    monitor.sent(ping[7:], 10.0 + pause)
    assert bool(monitor.violations) is wrong
    assert {each.rule for each in monitor.violations} <= {"W8"}


@pytest.mark.parametrize(("waited", "wrong"), [(0.0, True), (0.000224, True), (0.000226, False)])
def test_a_packet_before_a_plain_reply_can_end_breaks_the_single_talker_rule(
    waited: float, wrong: bool
) -> None:
    monitor = Monitor(LIMITS)  # 3 x (11 + 4) bytes at 2 Mbaud: 225 us
    monitor.sent(packet.make(254, 0x82, bytes.fromhex("84 00 04 00 01 02 05")), 1.0)
    monitor.sent(packet.make(1, 0x01), 1.0 + waited)
    assert [each.rule for each in monitor.violations] == (["W9"] if wrong else [])
    late = Monitor(LIMITS)  # stamps that may be late by 0.1 ms: only what is sure counts
    late.sent(packet.make(254, 0x82, bytes.fromhex("84 00 04 00 01 02 05")), 1.0, 0.9999)
    late.sent(packet.make(1, 0x01), 1.0 + waited, 0.99995 + waited)
    assert bool(late.violations) is (waited < 0.000125)


def test_caps_and_ranges_follow_the_operating_mode(tmp_path: Path) -> None:
    robot, calibration = world.files(tmp_path)
    text = robot.read_text()
    for mode, number, cap, upper in (
        ("position", 3, 2047, 3058),
        ("extended_position", 4, 2047, 3058),
        ("current_based_position", 5, 371, 3058),
    ):
        robot.write_text(text.replace("mode: position", f"mode: {mode}"))
        servo = world.Limits.read(robot, calibration, "main").servos[1]
        assert (servo.mode, servo.cap, servo.upper) == (number, cap, upper)
    narrow = calibration.read_text().replace("max_ticks: 3200", "max_ticks: 3000")
    calibration.write_text(narrow)
    assert world.Limits.read(robot, calibration, "main").servos[1].upper == 3058  # no limit registers there
    robot.write_text(text)
    assert world.Limits.read(robot, calibration, "main").servos[1].upper == 3000
