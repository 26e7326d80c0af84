"""The monitor in its relay, over real pseudo-terminals: the real daemon passes, wrong ones are caught."""

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tests.proof.busmon.started import Relayed, relayed
from tests.support.processes import BUSY, Daemon, Virtual, arm, favour, patiently, robot, until
from twind.client import CallError, Client
from twind.config.robot_file import load_robot


@contextmanager
def watched() -> Iterator[tuple[Virtual, Path, Relayed]]:
    """A virtual h24, a folder, and the relay before its port."""
    with robot() as (virtual, folder):
        file = load_robot("h24").path
        observe = folder / "run" / "observe.sock"
        with relayed(folder, virtual.ports["main"], file, virtual.calibration, observe=observe) as relay:
            favour(relay.process)
            try:
                yield virtual, folder, relay
            finally:
                print(relay.printed()[:3000])  # of a failed test: what was seen


@contextmanager
def daemon(virtual: Virtual, folder: Path, relay: Relayed, mode: str = "live") -> Iterator[Daemon]:
    """A daemon behind the relay; killed at the end if the test did not end it."""
    options = ("--mode", mode, "--calibration", str(virtual.calibration), "--port", str(relay.link))
    running = Daemon(folder / "run", *options)
    try:
        yield running
    finally:
        if running.process.poll() is None:
            running.process.kill()
        running.process.wait(10)


def nod(client: Client, seconds: float, most: float = 1.1) -> None:
    """Head and elbow away and back; left when that far, or when it has ended."""
    names = ["head_pitch", "l_elbow"]
    points = [
        {"positions": [0.4, -0.8], "time_from_start": seconds / 2},
        {"positions": [0.0, 0.0], "time_from_start": seconds},
    ]

    def run() -> None:
        for said in client.stream("SubmitTrajectory", trajectory={"joint_names": names, "points": points}):
            if said["phase"] == "aborted":  # a busy machine drops answers: the motion holds
                assert {each["code"] for each in said["findings"]} <= BUSY
            if said["progress"] > most:
                break

    patiently(run)


def stop_and_reset(running: Daemon, level: str, relay: Relayed) -> None:
    if level == "cut":
        relay.tell(level="cut")  # the daemon tells when, but not which
    with running.client() as client:
        client.call("EStop", level=level)
    running.reach(state="estop")

    def reset() -> bool:
        with running.client() as client, suppress(CallError):  # not before torque is read back off
            return bool(client.call("Reset")["state"] == "connected")
        return False

    until(reset, 15.0, "reset")


def test_the_daemon_arms_moves_stops_disarms_and_dies_without_a_bus_violation() -> None:
    with watched() as (virtual, folder, relay):
        with daemon(virtual, folder, relay) as running:
            relay.tell(pid=running.process.pid)
            running.reach(state="connected")
            with running.client() as client:
                arm(client)
                nod(client, 2.0)
                nod(client, 2.0, 0.3)
            stop_and_reset(running, "settle", relay)
            with running.client() as client:
                arm(client)
                nod(client, 2.0, 0.3)
            stop_and_reset(running, "cut", relay)
            with running.client() as client:
                arm(client)
                nod(client, 2.0)
                client.call("Disarm")
                arm(client)
                nod(client, 2.0, 0.3)
                assert running.end(signal.SIGKILL) == -signal.SIGKILL
        until(lambda: all(servo["tripped"] for servo in virtual.servos()), 5.0, "watchdogs trip")
        tell_servos(relay, virtual)
        with daemon(virtual, folder, relay) as second:
            second.reach(state="connected", inherited=True)
            with second.client() as client:
                arm(client)
                nod(client, 2.0)
            assert second.end() == 0
        assert relay.end() == 0, relay.printed()
        counts = relay.counts()
        print(counts)
        assert counts["violations"] == 0
        assert counts["goals"] > 200  # a busy machine aborts motions early
        assert counts["answers"] > 1000


def tell_servos(relay: Relayed, virtual: Virtual) -> None:
    """Stop of each servo, by its own clock (W11)."""
    servos = virtual.servos()
    delays = {str(servo["id"]): servo["trip_delay"] for servo in servos}
    relay.tell(told="servos", trip_delay=delays)
    assert len(delays) == 24


def test_a_mirror_passes_and_an_unplug_is_passed_on() -> None:
    with watched() as (virtual, folder, relay):
        with daemon(virtual, folder, relay, "mirror") as running:
            running.reach(state="connected")
            virtual.order(fault="unplug")
            running.reach(state="disconnected")
            virtual.order(fault="replug")
            running.reach(state="connected")
            time.sleep(0.5)
            assert running.end() == 0
        assert relay.end() == 0, relay.printed()
        assert relay.counts()["goals"] == 0
