"""The real daemon in virtual time under the monitor: every byte of a working day keeps the rules."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.proof.busmon import packet
from tests.proof.busmon.watched import Watched
from tests.support.daemon_rig import Rig
from tests.support.homing_rig import homed
from tests.support.planar_arm import arm_in
from twind import link
from twind.loop.procedures import damping
from twind.loop.procedures.torque_readback import torque_off
from twind.robot.modes import Mode
from twind.robot.trajectory import Trajectory
from twind.virtual.robot_ground_truth import JointGroundTruth, RobotGroundTruth
from twind.virtual.virtual_robot_spec import save


class Day:
    """A rig that is watched."""

    def __init__(self, folder: Path, robot: str = "h24", mode: Mode = Mode.LIVE, **how: Any) -> None:
        self.rig = Rig(robot, mode, **how)
        save(self.rig.made, folder / "calibration.yaml")
        self.watched = Watched(self.rig, folder / "calibration.yaml")
        self.rig.connect()
        self.run(0.6)  # temperature and voltage are read

    def run(self, seconds: float) -> None:
        for tick in range(round(seconds * 100)):
            if tick % 40 == 0:
                self.rig.send(link.RenewLease)
            self.rig.ticks(1)
            self.watched.look()

    def arm(self) -> None:
        self.rig.call(link.AcquireLease)
        assert self.rig.call(link.Arm).error is None
        self.run(0.1)

    def nod(self) -> None:
        """Every joint half-way to the middle of its travel and back, at a good part of its speed."""
        limits = self.rig.loop.robot.limits
        here = self.rig.loop.executor.reference.position
        away = here + np.clip(0.5 * (limits.lower + limits.upper) - here, -0.5, 0.5)
        rows = np.array([away, here, away, here])
        count = len(here)
        path = Trajectory(np.arange(1.0, 5.0), rows, np.ones(count, np.bool_), np.zeros_like(rows))
        self.rig.submit(path)

    def until_torque_off(self) -> None:
        """Run until torque is off, at most 7 s, and half a second more."""
        for _ in range(70):
            if torque_off(self.rig.loop):
                break
            self.run(0.1)
        assert torque_off(self.rig.loop)
        self.run(0.5)

    def stop(self, level: str) -> None:
        self.rig.send(link.EStop, level=level)
        self.until_torque_off()
        assert self.rig.call(link.Reset).error is None

    def verdict_of_reading(self) -> None:
        self.watched.verdict()
        assert all(monitor.answers > 50 for monitor in self.watched.monitors.values())

    def verdict(self) -> None:
        self.watched.verdict()
        assert all(monitor.goal_packets > 100 for monitor in self.watched.monitors.values())


@pytest.mark.parametrize("robot", ["h24", pytest.param("h24-split", marks=pytest.mark.slow)])
def test_arming_motion_stops_and_disarming_keep_every_rule(robot: str, tmp_path: Path) -> None:
    day = Day(tmp_path, robot)
    for level in ("settle", "cut"):
        day.arm()
        day.nod()
        day.run(1.3)
        assert day.rig.loop.executor.motion == "active"
        day.stop(level)
    day.arm()
    day.nod()
    day.run(1.0)
    assert day.rig.call(link.Disarm, ticks=800).error is None
    day.run(0.2)
    day.verdict()
    day.rig.close()


def test_a_stop_that_becomes_damping_keeps_every_rule(tmp_path: Path) -> None:
    day = Day(tmp_path)
    day.arm()
    day.nod()
    day.run(1.0)
    day.rig.send(link.EStop, level="settle")
    day.run(0.05)
    damping.demand(day.rig.loop, (), day.rig.clock.now())
    day.until_torque_off()
    day.verdict()
    day.rig.close()


def test_a_stop_that_is_found_keeps_every_rule(tmp_path: Path) -> None:
    with homed() as rig:
        save(rig.made, tmp_path / "calibration.yaml")
        watched = Watched(rig, tmp_path / "calibration.yaml")
        rig.ready(odd=False)
        found = rig.last(rig.find(times=2, speed=0.5)).parameters
        rig.undone()
        watched.look()
        watched.verdict()
        monitor = watched.monitors["main"]
        assert monitor.goal_packets > 100
        assert max(found["ticks"]) < monitor.servos.lower[rig.row], "it went where nobody else may"


@pytest.mark.parametrize("turns", [-2, 3])
def test_a_robot_whose_counts_are_turns_off_keeps_every_rule(turns: int, tmp_path: Path) -> None:
    off = {name: JointGroundTruth(turns=turns) for name in ("extended", "capped")}
    day = Day(tmp_path, arm_in(tmp_path), truth=RobotGroundTruth(off))
    day.arm()
    servos = day.watched.monitors["main"].servos
    assert abs(servos.goal[1]) > 4096 and abs(servos.goal[2]) > 4096
    day.nod()
    day.run(3.0)
    day.stop("settle")
    day.verdict()
    day.rig.close()


def test_a_gripper_that_is_held_by_its_current_keeps_every_rule(tmp_path: Path) -> None:
    day = Day(tmp_path, "koch")
    day.arm()
    day.run(0.2)
    day.verdict_of_reading()
    assert day.watched.monitors["main"].limits.servos[6].cap == 400  # mA, its current limit
    day.rig.close()


def test_a_sensor_is_read_and_never_written(tmp_path: Path) -> None:
    day = Day(tmp_path, "h24-standing")
    day.arm()
    day.verdict_of_reading()
    monitor = day.watched.monitors["main"]
    monitor.sent(packet.make(200, 0x03, bytes.fromhex("40 00 01")), day.rig.clock.now())
    assert {each.rule for each in monitor.violations} == {"W2"}
    day.rig.close()


def test_a_mirror_writes_nothing(tmp_path: Path) -> None:
    day = Day(tmp_path, mode=Mode.MIRROR)
    day.nod()
    day.run(1.0)
    day.verdict_of_reading()
    day.rig.close()


def test_a_daemon_whose_own_checks_are_gone_is_caught(tmp_path: Path) -> None:
    """The loop's reference is bent behind its gate: nobody but the monitor is left to see it."""
    day = Day(tmp_path)
    day.arm()
    hardware = day.rig.loop.hardware
    exchange = hardware.exchange
    bent = np.zeros(len(day.rig.names))
    bent[day.rig.names.index("head_yaw")] = 0.15  # rad, in one tick; far inside its range

    def bend(goal: np.ndarray | None, now: float) -> object:
        return exchange(goal if goal is None else goal + bent, now)

    hardware.exchange = bend  # type: ignore[method-assign]
    day.run(0.1)
    rules = {each.rule for monitor in day.watched.monitors.values() for each in monitor.violations}
    assert rules == {"W3"}
    day.rig.close()
