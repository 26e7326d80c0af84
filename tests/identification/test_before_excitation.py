"""Refusals of `identify --live` and `tune gains` before the lease is taken: nothing moves."""

import math
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from twind.command_line.verb import Rejected
from twind.config.robot_file import load_robot
from twind.exceptions import TwindError
from twind.identification import identify_run, tune_run
from twind.identification.identify_run import identify_live
from twind.identification.tune_run import tune_gains
from twind.virtual.virtual_robot_spec import make_spec, save

OPTIONS = Namespace(
    socket=None,
    take=False,
    write=False,
    robot=None,
    calibration=None,
    amplitude=0.4,
    step=0.15,
    overshoot=0.1,
    tries=8,
)


class DescribingClient:
    """An observer of an armed robot in mode live."""

    def __init__(self, robot: str) -> None:
        file = load_robot(robot)
        described = msgspec.to_builtins(file, enc_hook=str)
        self._answers = {
            "GetRobot": {"robot": described, "calibration": None, "mjcf": file.mjcf},
            "GetStatus": {"status": {"mode": "live", "state": "armed", "armed": True}},
        }

    def __enter__(self) -> "DescribingClient":
        return self

    def __exit__(self, *_: object) -> None: ...

    def call(self, method: str) -> Any:
        return self._answers[method]


class LeaseAsked(Exception):
    """A program connected as the operator of a robot."""


@pytest.fixture
def run_on(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Put a robot behind both programs, whose connection with a lease raises LeaseAsked."""

    def refuse(*_: object, **__: object) -> None:
        raise LeaseAsked

    def put(robot: str) -> None:
        for module in (identify_run, tune_run):
            monkeypatch.setattr(module, "observer", lambda options: DescribingClient(robot))
            monkeypatch.setattr(module, "Robot", refuse)

    return put


PROGRAMS: list[Callable[[str], None]] = [
    lambda joint: identify_live(OPTIONS, [joint]),
    lambda joint: tune_gains(OPTIONS, [joint]),
]


@pytest.mark.parametrize("program", PROGRAMS, ids=["identify", "tune"])
@pytest.mark.parametrize("joint", ["l_knee", "head_yaw"])
def test_a_robot_on_its_own_feet_is_refused_in_one_line_with_the_remedy(
    run_on: Callable[[str], None], program: Callable[[str], None], joint: str
) -> None:
    run_on("h24-standing")
    with pytest.raises(Rejected) as caught:
        program(joint)
    reason = str(caught.value)
    assert "h24-standing has support free" in reason and "\n" not in reason
    assert "hang it on a gantry or fix its base" in reason


@pytest.mark.parametrize("program", PROGRAMS, ids=["identify", "tune"])
@pytest.mark.parametrize(("robot", "joint"), [("h24", "l_knee"), ("koch", "elbow_flex")])
def test_a_robot_on_a_gantry_or_a_fixed_base_is_moved(
    run_on: Callable[[str], None], program: Callable[[str], None], robot: str, joint: str
) -> None:
    run_on(robot)
    with pytest.raises(LeaseAsked):
        program(joint)


@pytest.fixture
def calibrated(tmp_path: Path) -> Path:
    """A folder with calibrations of pan-tilt, one of them under a name that no model can be saved beside."""
    save(make_spec(load_robot("pan-tilt")), tmp_path / "mine.yaml")
    (tmp_path / "broken.yaml").write_text("format: [")
    (tmp_path / "My robot.yaml").write_text((tmp_path / "mine.yaml").read_text())
    return tmp_path


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"write": True}, "--write needs --robot and --calibration"),
        ({"write": True, "robot": "pan-tilt"}, "--write needs --robot and --calibration"),
        ({"write": True, "robot": "pan-tilt", "calibration": "My robot.yaml"}, "is no name for a file"),
        ({"write": True, "robot": "pan-tilt", "calibration": "absent/mine.yaml"}, "folder is missing"),
        ({"robot": "pan-tilt", "calibration": "broken.yaml"}, "broken.yaml:2:1: not YAML"),
        ({"robot": "pan-tilt", "calibration": "absent.yaml"}, "absent.yaml: cannot be read"),
        ({"robot": "absent.yaml"}, "absent.yaml: cannot be read"),
        ({"robot": "koch"}, "its joints are not those of koch: "),
        ({"robot": "koch", "calibration": "mine.yaml"}, "mine.yaml:"),
        *(
            ({"amplitude": wrong}, f"--amplitude {wrong:g}: above 0, at most 1.5 rad")
            for wrong in (math.nan, 0.0, math.inf, -0.4, 1.51)
        ),
    ],
)
def test_a_command_line_that_cannot_be_carried_out_is_refused_before_the_robot_moves(
    run_on: Callable[[str], None],
    calibrated: Path,
    monkeypatch: pytest.MonkeyPatch,
    changes: dict[str, Any],
    reason: str,
) -> None:
    run_on("pan-tilt")
    monkeypatch.chdir(calibrated)
    given = {**vars(OPTIONS), **changes}
    given["calibration"] = given["calibration"] and Path(given["calibration"])
    with pytest.raises(TwindError) as caught:
        identify_live(Namespace(**given), ["tilt"])
    assert reason in str(caught.value)


def test_a_command_line_that_can_be_carried_out_moves_the_robot(
    run_on: Callable[[str], None], calibrated: Path
) -> None:
    run_on("pan-tilt")
    given = {"robot": "pan-tilt", "calibration": calibrated / "mine.yaml", "write": True, "amplitude": 1.5}
    with pytest.raises(LeaseAsked):
        identify_live(Namespace(**{**vars(OPTIONS), **given}), ["tilt"])
