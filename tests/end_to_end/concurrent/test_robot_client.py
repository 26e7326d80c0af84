"""`twind.Robot` and `twind.aio.Robot` with a real daemon in mode sim."""

import asyncio
import math
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import twind.aio
from tests.support.processes import Daemon, patiently
from twind import Robot
from twind.client import CallError, Client, Disconnected, MotionFailed, Refused
from twind.exceptions import InvalidInput


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    running = Daemon(tmp_path_factory.mktemp("sim") / "run", "--mode", "sim")
    running.reach(sim_connected=True)
    yield running
    running.kill()


@pytest.fixture
def robot(daemon: Daemon) -> Iterator[Robot]:
    with Robot(daemon.sockets) as made:
        yield made


def test_a_robot_moves_in_three_lines_and_shows_where_it_is(robot: Robot) -> None:
    outcome = patiently(lambda: robot.move({"head_yaw": np.float32(0.3)}, time=np.float64(1.0)))
    assert outcome.duration == pytest.approx(1.0, abs=0.05)
    snapshot = next(each for each in robot.states() if abs(each.joints["head_yaw"].position or 0.0) > 0.25)
    assert snapshot.position.shape == snapshot.age.shape == (len(robot.names),)
    assert snapshot.fresh(1.0).all()
    assert "head_yaw" in snapshot.to_html()
    patiently(lambda: robot.move({"head_yaw": 0.0}, degrees=True))


def test_refusals_and_wrong_names_are_errors_with_reasons(robot: Robot) -> None:
    with pytest.raises(Refused, match="POS_LIMIT: head_yaw"):
        patiently(lambda: robot.move({"head_yaw": 500.0}, time=20.0, degrees=True))
    with pytest.raises(InvalidInput, match="no motion 'wvae'"):
        robot.play("wvae")
    with pytest.raises(InvalidInput, match="no pose 'flat'"):
        robot.pose("flat")
    with pytest.raises(InvalidInput, match="need"):
        robot.follow(["head_yaw"], [[0.0, 0.1]], [1.0])
    with pytest.raises(InvalidInput, match="no joint tail"):
        robot.stream(["tail"])


def test_the_lease_is_kept_while_nothing_moves_and_given_back_at_the_end(daemon: Daemon) -> None:
    with Robot(daemon.sockets) as robot:
        patiently(lambda: robot.move({"head_yaw": 0.1}, time=1.0))
        time.sleep(2.0)
        with Client(daemon.sockets) as other, pytest.raises(CallError, match="lease"):
            other.call("AcquireLease")
        patiently(lambda: robot.move({"head_yaw": 0.0}, time=1.0))
    with Client(daemon.sockets) as other:
        other.call("AcquireLease")


def test_a_motion_is_stopped_from_another_thread(robot: Robot) -> None:
    stopper = threading.Timer(0.7, robot.stop)
    stopper.start()
    with pytest.raises(MotionFailed, match="cancelled"):
        patiently(lambda: robot.follow(["head_yaw"], [[0.2], [0.3]], [4.0, 8.0]))
    stopper.join()


def test_a_stream_of_goals_is_followed_and_paced(robot: Robot) -> None:
    patiently(lambda: robot.move({"head_yaw": 0.3}, time=1.0))
    slowest = 0.0
    with robot.stream(["head_yaw"], rate=100.0, strict=False) as stream:
        for t in stream:
            begun = time.monotonic()
            stream.send({"head_yaw": 0.3 * math.cos(t)})
            slowest = max(slowest, time.monotonic() - begun)
            if t >= 2.0:
                break
    report = stream.report
    assert report.sent + report.late == pytest.approx(201, abs=1)
    assert report.accepted > 0.5 * report.sent, (report, report.refusal)
    assert report.accepted + report.superseded + report.refused == report.sent
    assert slowest < 0.25  # a tick's answer would be waited for 200 times


def test_after_a_restart_it_reconnects_and_takes_the_lease_again(tmp_path: Path) -> None:
    first = Daemon(tmp_path / "run", "--mode", "sim")
    first.reach(sim_connected=True)
    try:
        with Robot(first.sockets) as robot:
            patiently(lambda: robot.move({"head_yaw": 0.1}, time=1.0))
            assert robot.state.joints
            first.end()
            first = Daemon(tmp_path / "run", "--mode", "sim")
            first.reach(sim_connected=True)
            patiently(lambda: robot.move({"head_yaw": 0.2}, time=1.0))
            assert robot.state.joints["head_yaw"].age is not None
    finally:
        first.kill()


def test_a_closed_robot_moves_nothing(daemon: Daemon) -> None:
    robot = Robot(daemon.sockets)
    robot.close()
    robot.close()
    with pytest.raises(Disconnected, match="closed"):
        robot.move({"head_yaw": 0.1}, time=1.0)
    robot.stop()  # by a connection of its own


def test_an_observer_reads_and_cannot_move(daemon: Daemon) -> None:
    with Robot(daemon.sockets, read_only=True) as robot:
        assert robot.status["mode"] == "sim"
        with pytest.raises(CallError, match="role"):
            robot.move({"head_yaw": 0.1}, time=1.0)


def test_the_same_with_asyncio_where_a_cancelled_motion_stops(daemon: Daemon) -> None:
    async def drive() -> str:
        async with twind.aio.Robot(daemon.sockets) as robot:
            await robot.move({"head_yaw": 0.2}, time=1.0)
            async with robot.stream(["head_yaw"], strict=False) as stream:
                async for t in stream:
                    stream.send({"head_yaw": 0.2 * math.cos(t)})
                    if t > 0.3:
                        break
            assert stream.report.sent > 3
            motion = asyncio.create_task(robot.move({"head_yaw": -0.5}, time=8.0))
            await asyncio.sleep(1.0)
            motion.cancel()
            with pytest.raises(asyncio.CancelledError):
                await motion
            await asyncio.sleep(1.5)
            return str(robot.blocking.status["motion"])

    assert patiently(lambda: asyncio.run(drive())) in ("holding", "idle")
