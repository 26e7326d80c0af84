"""Refusals of `identify --live` and `tune gains` before the lease is taken: nothing moves."""

from argparse import Namespace
from collections.abc import Callable
from typing import Any

import msgspec
import pytest

from twind.command_line.verb import Rejected
from twind.config.robot_file import load_robot
from twind.identification import identify_run, tune_run
from twind.identification.identify_run import identify_live
from twind.identification.tune_run import tune_gains

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
