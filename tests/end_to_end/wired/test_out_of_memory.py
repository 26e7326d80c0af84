"""Without memory for a new front process the loop goes on, the robot holds, and serves again later."""

import os
import resource
import signal
import time

from tests.support.processes import arm, daemon, robot, until

NO_MORE = 64 << 20  # bytes of address space: less than the loop has, so that it and its children get no more
WITHOUT = 3.0  # s without a front
COUNTS = 2  # that a joint may move where it holds


def test_a_robot_whose_front_process_cannot_be_started_holds_its_pose_until_there_is_memory() -> None:
    with robot("pan-tilt") as (virtual, folder), daemon(virtual, folder) as running:
        running.reach(state="connected", hw_connected=True)
        with running.client() as client:
            arm(client)
        time.sleep(WITHOUT)  # it comes to rest
        before = [servo["position"] for servo in virtual.servos()]
        pid = running.process.pid
        limits = resource.prlimit(pid, resource.RLIMIT_AS)
        resource.prlimit(pid, resource.RLIMIT_AS, (NO_MORE, limits[1]))
        os.kill(running.front(), signal.SIGKILL)
        until(lambda: "cannot be started" in running.log.read_text(), 20.0, running.log.read_text)
        time.sleep(WITHOUT)
        assert running.process.poll() is None, running.log.read_text()
        servos = virtual.servos()
        assert all(servo["torque"] and not servo["tripped"] for servo in servos)
        assert max(abs(now["position"] - then) for now, then in zip(servos, before, strict=True)) <= COUNTS
        resource.prlimit(pid, resource.RLIMIT_AS, limits)
        status = running.reach(state="armed", motion="holding")
        assert status["lease"] is None
