"""LeRobot 0.4.4 `FeetechMotorsBus`, unmodified, calibrates and moves an arm of virtual STS3215.

`CLIENT:` marks its own faults. Runs where `lerobot` and `deepdiff` are installed; of what it imports beside
them, only packages that a motor bus does not use may be replaced by empty modules.
"""

import os
import sys
import threading
import types
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from operator import sub
from pathlib import Path
from typing import Any

import pytest

from tests.support.processes import Virtual, until

UNUSED = ("torch", "accelerate", "datasets", "datasets.utils", "datasets.utils.logging")
ENDS = {"shoulder_pan": 1.9, "shoulder_lift": 0.7, "elbow_flex": 0.7, "wrist_flex": 0.7, "gripper": 0.7}
NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")

pytest.importorskip("scservo_sdk")
pytest.importorskip("deepdiff", reason="lerobot is not installed: it needs deepdiff, torch and many more")
pytest.importorskip("lerobot", reason="lerobot 0.4.4 is not installed")


@pytest.fixture
def arm(tmp_path: Path) -> Iterator[Virtual]:
    virtual = Virtual(tmp_path, "so101")
    yield virtual
    virtual.close()


@pytest.fixture
def bus(arm: Virtual, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    missing = {name for name in UNUSED if "." not in name and find_spec(name) is None}
    for name in [name for name in UNUSED if name.partition(".")[0] in missing]:
        empty: Any = types.ModuleType(name)
        empty.Accelerator = empty.disable_progress_bar = empty.enable_progress_bar = object
        monkeypatch.setitem(sys.modules, name, empty)
    from lerobot.motors import Motor, MotorNormMode
    from lerobot.motors.feetech import FeetechMotorsBus

    norm = MotorNormMode.RANGE_M100_100
    motors = {name: Motor(id, "sts3215", norm) for id, name in enumerate(NAMES, 1)}
    found = FeetechMotorsBus(arm.ports["main"], motors)
    found.connect()
    yield found
    found.disconnect(disable_torque=False)


def rest(arm: Virtual) -> None:
    """Wait until no joint has moved for ten readings."""
    places: list[list[float]] = []

    def stands() -> bool:
        places.append([each["encoder"] for each in arm.servos()])
        return len(places) > 10 and max(map(abs, map(sub, places[-1], places[-10]))) < 1.0

    until(stands, 15.0, "the hands do not come to rest")


def sweep(arm: Virtual, done: Callable[[], None]) -> None:
    """Move each joint to both of its ends by hand, then call `done`."""
    for name, end in ENDS.items():
        for to in (end, -0.05 if name == "gripper" else -end):
            arm.order(fault="hand", pose={name: to}, speed=6.0)
            rest(arm)
        arm.order(fault="hand", pose={name: 0.0}, speed=6.0)
    done()


def test_lerobot_calibrates_and_moves_an_arm(arm: Virtual, bus: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from lerobot.motors import MotorCalibration

    assert not bus.is_calibrated
    bus.disable_torque()
    arm.order(fault="hand", pose=dict.fromkeys(NAMES, 0.0))
    rest(arm)
    offsets = bus.set_half_turn_homings()
    centred = bus.sync_read("Present_Position", normalize=False)
    assert all(abs(count - 2047) <= 2 for count in centred.values()), centred

    reader, writer = os.pipe()
    with open(reader) as keyboard:
        monkeypatch.setattr(sys, "stdin", keyboard)
        hands = threading.Thread(target=sweep, args=(arm, lambda: os.write(writer, b"\n")))
        hands.start()
        mins, maxes = bus.record_ranges_of_motion(list(ENDS), display_values=False)
        hands.join()
    os.close(writer)
    for name, end in ENDS.items():
        assert maxes[name] - 2047 == pytest.approx(end / 6.2832 * 4096, abs=20), name
    mins["wrist_roll"], maxes["wrist_roll"] = 0, 4095
    bus.write_calibration(
        {
            name: MotorCalibration(id, 0, offsets[name], mins[name], maxes[name])
            for id, name in enumerate(NAMES, 1)
        }
    )
    assert bus.is_calibrated

    arm.order(fault="hand", off=True)
    bus.configure_motors()
    for name in NAMES:
        bus.write("Operating_Mode", name, 0)
        bus.write("P_Coefficient", name, 16)
    bus.enable_torque()  # CLIENT: it writes no goal before, so each servo keeps the one that it has
    goals = {"wrist_flex": 40.0, "wrist_roll": -25.0}
    bus.sync_write("Goal_Position", goals)

    def arrived() -> bool:
        found = bus.sync_read("Present_Position", list(goals))
        return all(abs(found[name] - goal) < 1.0 for name, goal in goals.items())

    until(arrived, 10.0, "it does not arrive")
    bus.disable_torque()
    assert not any(each["torque"] for each in arm.servos())


def test_lerobot_leaves_torque_on_behind_a_servo_with_an_error(arm: Virtual, bus: Any) -> None:
    """CLIENT: `disable_torque` ends at the first error byte; the servo has carried out the write."""
    bus.enable_torque()
    arm.order(fault="damage", id=3, bits=0x20)
    with pytest.raises(RuntimeError, match="verload"):
        bus.disable_torque()
    assert [each["torque"] for each in arm.servos()] == [False] * 3 + [True] * 3
