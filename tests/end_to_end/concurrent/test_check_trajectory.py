"""`twindctl check trajectory FILE --robot …` says what the daemon's `Check` says of a robot in that pose."""

import json
import time
from collections.abc import Iterator
from dataclasses import replace
from math import sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.daemon_rig import known_calibration
from tests.support.processes import Daemon
from twind.client import CallError, Client, Refused
from twind.config.robot_file import load_robot
from twind.ctl.ctl_main import main
from twind.ctl.offline_check import calibration_note, pose, verdict
from twind.twin.binding import bind

BINDING = bind(load_robot("h24"), None)
NAMES = list(BINDING.joint_map.names)
Message = dict[str, Any]


def points(*rows: tuple[float, list[float]], velocity: float | None = None) -> list[Message]:
    extra = {} if velocity is None else {"velocities": [velocity] * len(rows[0][1])}
    return [{"time_from_start": t, "positions": row, **extra} for t, row in rows]


def one(joint: str, *rows: tuple[float, float], **more: Any) -> Message:
    """A trajectory of one joint."""
    return {"joint_names": [joint], "points": points(*[(t, [p]) for t, p in rows]), **more}


FAST_END = points((1.0, [0.1]), (2.0, [0.6]), velocity=0.5)
CASES: dict[str, Message] = {
    "good": one("head_yaw", (1.0, 0.3), (2.0, 0.0)),
    "out of limits": one("head_yaw", (2.0, 1.6), (4.0, 0.0)),
    "far out of limits": one("l_elbow", (2.0, 1.6)),
    "too fast, asked to reject": one("head_yaw", (0.1, 0.9), (2.0, 0.0), policy="reject"),
    "retimed": one("head_yaw", (0.1, 0.9), (2.0, 0.0), policy="retime"),
    "retimed by the file": one("head_yaw", (0.1, 0.9), (2.0, 0.0)),
    "no slower heals it": one("head_yaw", (0.1, 1.7), (0.2, 0.0), policy="retime"),
    "not at rest": {"joint_names": ["head_yaw"], "points": FAST_END},
    "a stop is appended": {"joint_names": ["head_yaw"], "points": FAST_END, "append_stop": True},
    "jumps": one("head_yaw", (0.0, 0.4), (2.0, 0.0)),
    "into itself": one("r_shoulder_pitch", (2.0, 0.0), (4.0, 0.0))
    | {
        "joint_names": ["l_shoulder_pitch", "l_shoulder_roll", "l_shoulder_yaw", "l_elbow"],
        "points": points((2.0, [-0.6, -0.1, -1.4, -2.1]), (4.0, [0.0, 0.0, 0.0, 0.0])),
    },
    "legs crossed": {
        "joint_names": ["l_hip_roll", "r_hip_roll"],
        "points": points((2.0, [-0.4, 0.4]), (4.0, [0.0, 0.0])),
    },
    "through the other arm": {
        "joint_names": [
            "l_shoulder_pitch",
            "l_shoulder_yaw",
            "l_elbow",
            "r_shoulder_pitch",
            "r_shoulder_yaw",
        ],
        "points": points((2.0, [-1.2, -1.4, -1.6, -1.2, 1.4]), (4.0, [0.0] * 5)),
    },
    "too many points": one("head_yaw", *[(0.01 * (i + 1), 0.0) for i in range(2001)]),
    "long, in slices": one("head_yaw", *[(0.02 * (i + 1), 0.2 * sin(0.01 * i)) for i in range(1500)]),
    "too long": one("head_yaw", (100.0, 0.1)),
    "nobody": {"joint_names": [], "points": []},
    "unknown joint": one("tail", (1.0, 0.0)),
    "twice": {"joint_names": ["head_yaw", "head_yaw"], "points": points((1.0, [0.0, 0.0]))},
    "ragged": {"joint_names": ["head_yaw"], "points": points((1.0, [0.0, 0.0]))},
    "times": one("head_yaw", (1.0, 0.0), (0.5, 0.1)),
    "later": one("head_yaw", (1.0, 0.3), start_in=5.0),
    "too much later": one("head_yaw", (1.0, 0.3), start_in=500.0),
    "bad tolerance": one("head_yaw", (1.0, 0.3), tolerances=[{"joint": "head_yaw", "path": -1.0}]),
    "unknown policy": one("head_yaw", (1.0, 0.3), policy="pray"),
    "unknown field": one("head_yaw", (1.0, 0.3), colour="red"),
    "a word for a number": one("head_yaw", (1.0, "much")),
}


def random_cases(count: int) -> dict[str, Message]:
    """Some fine, some not: a few joints, a few points, all degrees."""
    random = np.random.default_rng(11)
    found = {}
    for i in range(count):
        joints = [str(name) for name in random.choice(NAMES, random.integers(1, 5), replace=False)]
        places = [NAMES.index(name) for name in joints]
        size = random.choice([0.1, 0.5, 1.02])
        times = np.cumsum(random.uniform(0.3, 2.0, random.integers(1, 4))).tolist()
        rows = size * random.uniform(
            BINDING.limits.lower[places], BINDING.limits.upper[places], (len(times), len(places))
        )
        message: Message = {"joint_names": joints, "points": points(*zip(times, rows.tolist(), strict=True))}
        if random.random() < 0.5:
            for point in message["points"]:
                point["velocities"] = random.uniform(-0.3, 0.3, len(joints)).tolist()
        message["append_stop"] = bool(random.random() < 0.5)
        message["policy"] = str(random.choice(["reject", "retime"]))
        found[f"random {i}"] = message
    return found


class Asking:
    """A daemon in `sim`, and a client of it that holds the lease."""

    def __init__(self, folder: Path) -> None:
        self.daemon = Daemon(folder, "--mode", "sim", "--robot", "h24")
        self.daemon.reach(mode="sim")
        self.client = Client(str(folder))
        self.stand("rest")  # what hangs after the start hangs a nanoradian off

    def check(self, message: Message) -> Any:
        """The verdict, or the error. At most so many a second are let through."""
        while True:
            try:
                self.client.call("AcquireLease")
                return self.client.call("Check", trajectory=message)["verdict"]
            except Refused as error:
                if error.findings[0]["code"] != "RATE_LIMIT":
                    raise
                time.sleep(0.1)
            except CallError as error:
                return error.error, error.parameters

    def stand(self, name: str) -> None:
        """Move the simulation into a pose of the robot file."""
        self.client.call("AcquireLease")
        goal = pose(BINDING.robot, name).tolist()
        message = {"joint_names": NAMES, "points": points((1.2, goal)), "policy": "reject"}
        phases = [reply["phase"] for reply in self.client.stream("SubmitTrajectory", trajectory=message)]
        assert phases[-1] == "succeeded"

    def close(self) -> None:
        self.client.close()
        assert self.daemon.end() == 0


@pytest.fixture(scope="module")
def asking(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Asking]:
    asking = Asking(tmp_path_factory.mktemp("sim"))
    yield asking
    asking.close()


def offline(message: Message, name: str = "rest") -> Any:
    try:
        return verdict(BINDING, pose(BINDING.robot, name), message)
    except CallError as error:
        return error.error, error.parameters


@pytest.mark.parametrize("name", CASES)
def test_check_trajectory_offline_and_the_daemon_agree_on_each_case(asking: Asking, name: str) -> None:
    assert offline(CASES[name]) == asking.check(CASES[name])


def test_check_trajectory_offline_and_the_daemon_agree_on_random_cases(asking: Asking) -> None:
    many = random_cases(40)
    said = {name: asking.check(message) for name, message in many.items()}
    assert {name: offline(message) for name, message in many.items()} == said
    refused = [name for name, found in said.items() if found["refusals"]]
    assert 8 < len(refused) < 32


def test_check_trajectory_offline_and_the_daemon_agree_in_another_pose(asking: Asking) -> None:
    asking.stand("arms_out")
    some = [CASES["good"], CASES["into itself"], CASES["jumps"], *random_cases(8).values()]
    try:
        assert [offline(message, "arms_out") for message in some] == [asking.check(each) for each in some]
    finally:
        asking.stand("rest")


# ------------------------------------------------------------------------------- the verb


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    """Exit code and standard output of `twindctl check trajectory`."""
    code = main(["check", "trajectory", *arguments])
    return code, capsys.readouterr().out


def file(folder: Path, name: str) -> str:
    path = folder / "motion.json"
    path.write_text(json.dumps(CASES[name]))
    return str(path)


@pytest.mark.parametrize("name", ["good", "out of limits", "retimed by the file", "unknown field"])
def test_the_verb_prints_and_ends_alike(
    asking: Asking, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    asking.client.call("ReleaseLease")
    given = file(tmp_path, name)
    time.sleep(0.2)
    online = run(capsys, given, "--json", "--socket", str(asking.daemon.sockets))
    alone = run(capsys, given, "--json", "--robot", "h24")
    asking.client.call("AcquireLease")
    assert online[0] == alone[0]
    assert json.loads(online[1]) == json.loads(alone[1])


def test_a_motion_of_the_robot_is_found_by_name(capsys: pytest.CaptureFixture[str]) -> None:
    from twind.command_line.trajectory_files import motion_names

    code, said = run(capsys, motion_names()[0], "--robot", "h24")
    assert (code, said.splitlines()[-1]) == (0, "accepted")


def test_a_check_without_a_daemon_names_the_limits_that_it_used(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    alone = run(capsys, file(tmp_path, "good"), "--robot", "h24")[1]
    assert "--calibration FILE was not given: checked with limits_rad of " in alone
    whole = known_calibration("h24")
    first, *others = whole.joints
    sweep = (first.zero_ticks - 300, first.zero_ticks + 300)
    narrow = replace(whole, joints=(replace(first, sweep_ticks=sweep), *others))
    said = calibration_note(BINDING, bind(load_robot("h24"), narrow))
    assert said.startswith("note: the calibration narrows limits of the robot file: ")
    assert f"{first.name} lower by 1.0" in said and f"{first.name} upper by 1.0" in said
    assert "narrows no limit" in calibration_note(BINDING, BINDING)


def test_without_a_calibration_the_joints_nearest_to_their_limits_are_named() -> None:
    motion = one("l_shoulder_roll", (0.0, 0.0), (2.0, 1.9))
    said = calibration_note(BINDING, None, motion)
    assert "l_shoulder_roll comes within 0.100 rad of its lower limit" in said
    assert "l_shoulder_roll comes within 0.200 rad of its upper limit" in said
    assert said.index("lower limit") < said.index("upper limit")
    for odd in ({}, {"joint_names": ["absent"], "points": [{}]}, one("l_shoulder_roll", (1.0, 3.0))):
        assert "upper limit" not in calibration_note(BINDING, None, odd)


def test_a_pose_moves_the_start(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "motion.json"
    path.write_text(json.dumps(one("l_shoulder_roll", (0.0, 0.0), (2.0, 0.0))))
    assert run(capsys, str(path), "--robot", "h24")[0] == 0
    code, said = run(capsys, str(path), "--robot", "h24", "--pose", "arms_out")
    assert code == 1 and "START_JUMP" in said


@pytest.mark.parametrize(
    ("arguments", "code", "word"),
    [
        (["--robot", "h24", "--pose", "headstand"], 2, "rest"),
        (["--pose", "rest"], 2, "--robot"),
        (["--calibration", "x.yaml"], 2, "--robot"),
        (["--robot", "nobody"], 1, "nobody"),
        (["--robot", "h24", "--calibration", "/nowhere.yaml"], 1, "nowhere"),
    ],
)
def test_an_invalid_argument_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], code: int, word: str
) -> None:
    assert main(["check", "trajectory", file(tmp_path, "good"), *arguments]) == code
    assert word in capsys.readouterr().err
