"""A daemon that answers what the steps of a calibration ask, from servos that are numbers in a table."""

import argparse
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from twind.client import CallError, Disconnected, NoAnswer
from twind.config.calibration_file import Calibration, load_calibration
from twind.config.robot_spec import RobotFile
from twind_calibration.calibrating.calibration_steps import STEPS

__all__ = ["FakeDaemon", "held", "options_of", "recorded", "stand_in"]
LEASE = 1.0  # s


def options_of(step: str, *words: str) -> argparse.Namespace:
    """As `twindctl calibrate STEP` parses them."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--socket", default=None)
    STEPS[step].add_arguments(parser)
    return parser.parse_args(words)


class FakeDaemon:
    """In place of `Client`. `tick`: s that pass between two readings; a lease lasts one.

    `break_off(method, how)` is asked after each call was obeyed, and may raise.
    """

    def __init__(self, robot: RobotFile, file: Path, known: Calibration, mode: str = "live") -> None:
        self.robot = robot
        self.file = file
        self.mode = mode
        self.state = "connected"
        self.now = 100.0
        self.tick = 0.01
        self.leased_until = 0.0
        self.connected = False
        self.asked: list[str] = []
        self.states: list[str] = []  # at each reading
        self.servos: dict[int, dict[str, int]] = {}
        self.ids = {joint.actuator: joint.id for joint in robot.joints}
        self.ticks = {joint.actuator: 2048 for joint in robot.joints}
        self.break_off: Callable[[str, dict[str, Any]], None] = lambda method, how: None
        for entry in known.joints:
            one = entry.device
            self.servos[entry.id] = {
                "homing_offset": one.homing_offset_ticks,
                "drive_mode": one.drive_mode,
                "operating_mode": one.operating_mode,
                "min_position_limit": one.min_ticks,
                "max_position_limit": one.max_ticks,
                "moving_threshold": 10,
            }

    # --------------------------------------------------------------------------------- as a Client

    def __enter__(self) -> "FakeDaemon":
        return self

    def __exit__(self, *_: object) -> None: ...

    def close(self) -> None: ...

    def call(self, method: str, **how: Any) -> Any:
        """One call, and its answer."""
        self.asked.append(method)
        self.connected = True
        answer = getattr(self, f"_{method}", dict)(**how)
        try:
            self.break_off(method, how)
        except (Disconnected, NoAnswer):
            self.connected = False
            raise
        return answer

    def stream(self, method: str, **how: Any) -> Iterator[Any]:
        """Scan, or Monitor of topic `raw`."""
        self.asked.append(method)
        yield from self.scan() if method == "Scan" else self.readings()

    # --------------------------------------------------------------------------------- answers

    def _GetRobot(self) -> Any:
        read = {"path": str(self.robot.path), "text_sha256": self.robot.text_sha256}
        return {"robot": read, "mjcf": self.robot.mjcf, "calibration": None}

    def _GetParameters(self) -> Any:
        return {"parameters": {"calibration": str(self.file), "rate_hz": 100.0}}

    def _GetStatus(self, joints: bool = False) -> Any:
        told = [{"name": name, "position": 0.0, "torque": False, "heard": True} for name in self.robot.names]
        return {"status": {"mode": self.mode, "armed": False, "state": self.state}, "joints": told}

    def _AcquireLease(self, take: bool | None = None) -> Any:
        self.leased_until = self.now + LEASE
        return {}

    def _RenewLease(self) -> Any:
        self._settle()
        if not self.leased_until:
            raise CallError("io.twind.Control.Refused", {"findings": []})
        return self._AcquireLease()

    def _ReleaseLease(self) -> Any:
        self.leased_until = 0.0
        return {}

    def _Calibrate(self, on: bool) -> Any:
        self.state = "calibrating" if on else "connected"
        return {"state": self.state}

    def _WriteRegister(self, bus: str, id: int, name: str, value: int) -> Any:
        held = self.servos[id]
        after = held | {name: value}
        if after["min_position_limit"] > after["max_position_limit"]:  # as a servo answers
            raise CallError("io.twind.Control.DeviceFailed", {"message": "data range"})
        self.servos[id] = after
        return {"register": {"value": value}}

    def _settle(self) -> None:
        if self.leased_until and self.now > self.leased_until:
            self.state = "connected"
            self.leased_until = 0.0

    def scan(self) -> Iterator[Any]:
        for id, held in self.servos.items():
            yield {"id": id, "model": 1020, "firmware": self._firmware, "settings": dict(held)}

    _firmware = 47

    def readings(self) -> Iterator[Any]:
        names = list(self.ticks)
        while True:
            self.now += self.tick
            self._settle()
            self.states.append(self.state)
            ticks: Sequence[int] = [self.ticks[name] for name in names]
            raw = {"names": names, "ticks": ticks, "age_ms": [0.0] * len(names)}
            yield {"time": self.now, "raw": raw}


def stand_in(monkeypatch: pytest.MonkeyPatch, daemon: FakeDaemon, *modules: ModuleType) -> None:
    """Let those modules talk to it."""
    for module in modules:
        for name in ("operator", "observer"):
            monkeypatch.setattr(module, name, lambda options: daemon, raising=False)


def held(daemon: FakeDaemon, name: str) -> tuple[int, int]:
    """Limits of a servo."""
    servo = daemon.servos[daemon.ids[name]]
    return servo["min_position_limit"], servo["max_position_limit"]


def recorded(daemon: FakeDaemon, name: str) -> tuple[int, int]:
    """Limits of a servo, as the file has them."""
    device = load_calibration(daemon.file, daemon.robot).by_name[name].device
    return device.min_ticks, device.max_ticks
