"""`control.*`: a status over the socket, and a setpoint from the socket to the wire."""

import bisect
import random
import time
from collections.abc import Mapping
from functools import partial

from bench.daemon import BenchDaemon, StatusPoller, await_state, live, scratch, twind
from bench.harness import (
    ROUNDS,
    FigureSpec,
    MeasuredFigure,
    Measurement,
    MeasurementUnavailable,
    interleaved,
    medians,
    quantile,
    spread,
)
from bench.motion import armed
from bench.pty_tap import PtyTap, tapped
from twind.client import Client
from twind.config.robot_file import load_robot
from twind.loop.process.virtual_robot_process import VirtualRobotProcess

CALLS = 2000  # of one round
SETPOINTS = 120  # of one round
# s between two setpoints: until the last has arrived, then at any part of a tick
PAUSE = 0.06
SCATTER = 0.01
STEP = 0.005  # rad of every joint, to and fro
TICK = 10.0  # ms


def take_status() -> Mapping[str, MeasuredFigure]:
    """Round trip of one call after the other, in mode sim and in mode live beside the virtual servos."""
    with scratch() as first, scratch() as second, twind(first, "--mode", "sim") as sim, live(second) as real:
        askers = {"sim": StatusPoller(sim), "live": StatusPoller(real)}
        rounds: dict[str, list[float]] = {"sim": [], "live": []}

        def ask(name: str) -> float:
            trips = _trips(askers[name])
            rounds[name].append(quantile(trips, 0.99))
            return quantile(trips, 0.5)

        found = interleaved(ROUNDS, {name: partial(ask, name) for name in askers})
        size = askers["live"].ask()
        for asker in askers.values():
            asker.close()
    middle = medians(found)
    worst = medians(rounds)
    note = (
        f"live, {size} bytes of answer, bare socket on both ends of the call; p99 {worst['live']:.0f}; "
        f"mode sim: p50 {middle['sim']:.0f}, p99 {worst['sim']:.0f}; {spread(found['live'], 'µs')}"
    )
    return {"control.status_rtt_p50": MeasuredFigure(middle["live"], note)}


def _trips(client: StatusPoller) -> list[float]:
    trips = []
    for _ in range(CALLS):
        since = time.perf_counter()
        client.ask()
        trips.append((time.perf_counter() - since) * 1e6)
    return trips


def take_command() -> Mapping[str, MeasuredFigure]:
    """From just before the call is sent to the first byte of the packet that shows it."""
    robot = load_robot("h24")
    with scratch() as folder, VirtualRobotProcess("h24") as child:
        name, path = next(iter(child.ports.items()))
        with tapped(path, robot.bus(name).baud) as tap:
            files = ("--port", tap.path, "--calibration", str(child.calibration))
            with twind(folder, "--mode", "live", *files) as daemon:
                await_state(daemon, "connected")
                with armed(daemon) as client:
                    rounds = [_round(client, daemon, tap) for _ in range(ROUNDS)]
    worst = [quantile(late, 0.99) for late in rounds]
    middles = [quantile(late, 0.5) for late in rounds]
    value = medians({"": worst})[""]
    note = (
        f"{sum(map(len, rounds))} setpoints of 24 joints at any part of a tick, seen by a tap on the port; "
        f"p50 {medians({'': middles})['']:.1f}; {spread(worst, 'ms')}"
    )
    return {"control.command_to_bus_p99": MeasuredFigure(value, note, {"one tick": TICK})}


def _round(client: Client, daemon: BenchDaemon, tap: PtyTap) -> list[float]:
    """ms of each setpoint of a round."""
    client.call("AcquireLease")
    joints = client.call("GetStatus", joints=True)["joints"]
    names = [joint["name"] for joint in joints]
    places = [
        [joint["goal"] + way * STEP * (-1 if joint["goal"] > 0.0 else 1) for joint in joints]
        for way in (0, 1)
    ]
    pauses = random.Random(1)
    sent = []
    for k in range(SETPOINTS):
        time.sleep(PAUSE + pauses.random() * SCATTER)
        sent.append(time.monotonic())
        client.call("Setpoint", joint_names=names, positions=places[(k + 1) % 2], valid_for=0.1)
    time.sleep(0.1)
    return _matched(sent, tap)


def _matched(sent: list[float], tap: PtyTap) -> list[float]:
    """ms from each call to the first packet with other goals. Raises CannotTake when too few are clear."""
    goals = tap.goals()
    times = [when for when, _ in goals]
    found = []
    for when in sent:
        at = bisect.bisect_right(times, when)
        settled = at >= 2 and goals[at - 1][1] == goals[at - 2][1]
        changed = (time for time, rows in goals[at:] if rows != goals[at - 1][1])
        if settled and (first := next(changed, None)) is not None:
            found.append((first - when) * 1e3)
    if len(found) < 0.9 * len(sent):
        raise MeasurementUnavailable(
            f"only {len(found)} of {len(sent)} setpoints could be told apart on the wire"
        )
    return found


MEASUREMENTS = (
    Measurement({"control.status_rtt_p50": FigureSpec("µs", "≤ 150")}, take_status),
    Measurement({"control.command_to_bus_p99": FigureSpec("ms", "≤ 12")}, take_command),
)
