"""`can.*` of the daemon: what 24 CAN actuators cost it at 100 Hz, and a mixed robot at 200 Hz.

The actuators are `twind-virtual` behind serial adapters that speak slcan, on pseudo-terminals.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from bench.daemon import await_state, live, scratch
from bench.harness import FigureSpec, MeasuredFigure, Measurement, medians, spread
from bench.loop import missed, shares
from bench.motion import kept_moving
from twind.config.robot_file import load_robot

MISSED_SPAN = 30.0  # s


def take_share() -> Mapping[str, MeasuredFigure]:
    """CPU of loop and front together over seconds of real time, in % of a core."""
    with scratch() as folder:
        robot = str(all_can(folder / "h24-can.yaml"))
        with live(folder, robot=robot) as daemon, kept_moving(daemon):
            await_state(daemon, "armed")
            moving = shares(daemon)
    middle = medians(moving)
    note = (
        f"live, armed, 24 Damiao actuators moving, 12 on each of two buses: loop {middle['loop']:.2f}, "
        f"front {middle['front']:.2f}; {spread(moving['both'], '%')}"
    )
    return {"can.cpu_share_100hz": MeasuredFigure(middle["both"], note)}


def take_missed() -> Mapping[str, MeasuredFigure]:
    """12 serial servos at 3 Mbaud and 6 actuators on each of two CAN buses, 200 Hz, armed and moving.

    A process for each bus: one for all answers the buses one after the other, and hands over late.
    """
    with scratch() as folder:
        robot = fast_mixed(folder / "mixed.yaml")
        return {"can.missed_mixed_200hz": missed(folder, robot, 200, MISSED_SPAN, apart=True)}


def all_can(path: Path) -> Path:
    """The body of h24 on two CAN buses, 12 actuators each."""
    robot = _mixed("h24-can")
    robot["buses"] = {name: {"kind": "can", "bitrate": 1_000_000} for name in "ab"}
    robot["types"] = {"dm4310": robot["types"]["dm4310"]}
    robot["defaults"]["type"] = "dm4310"
    for place, joint in enumerate(robot["joints"].values()):
        joint |= {"type": "dm4310", "bus": "ab"[place // 12], "id": place % 12 + 1}
    return _written(robot, path)


def fast_mixed(path: Path) -> Path:
    """h24-mixed with a serial bus that 200 Hz fit on: 3 Mbaud, an adapter without a latency timer."""
    robot = _mixed("h24-mixed-fast")
    robot["buses"]["upper"] |= {"baud": 3_000_000, "latency_timer_ms": 0}
    return _written(robot, path)


def _mixed(name: str) -> dict[str, Any]:
    built_in = load_robot("h24-mixed").path
    robot: dict[str, Any] = yaml.safe_load(built_in.read_text())
    robot["name"] = name
    robot["model"]["mjcf"] = str(built_in.parent / robot["model"]["mjcf"])
    robot.pop("motions", None)
    return robot


def _written(robot: dict[str, Any], path: Path) -> Path:
    path.write_text(yaml.safe_dump(robot, sort_keys=False))
    return path


MEASUREMENTS = (
    Measurement({"can.cpu_share_100hz": FigureSpec("% of a core")}, take_share),
    Measurement({"can.missed_mixed_200hz": FigureSpec("%", "< 0.1")}, take_missed),
)
