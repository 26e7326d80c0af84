"""A calibration whose proof alone is another one is taken while the daemon runs; any other one waits."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from tests.support.daemon_rig import Rig
from tests.support.h24_calibration import DEVICES
from tests.support.reload_rig import briefed, files, reread_of
from twind import link
from twind.config.calibration_file import Calibration, fitting, save_calibration
from twind.config.config_files import ConfigSources, describe
from twind.config.hot_keys import PROOF
from twind.config.robot_file import load_robot
from twind.front.reload_worker import read_again

SHOWN = {"sign": "gravity", "base_pose": "back", "slope_ratio": 0.94}


def put(sources: ConfigSources, calibration: Calibration) -> None:
    path = Path(str(sources.calibration))
    save_calibration(calibration, path.parent, path.stem)


@pytest.fixture
def ground(tmp_path: Path) -> tuple[ConfigSources, Calibration]:
    sources = files(tmp_path)
    robot = load_robot(str(tmp_path / "body.yaml"))
    zeros = dict.fromkeys(robot.names, 2048)
    made = fitting(robot, zeros, DEVICES, created="2026-11-21T09:14:03Z", tool="twind 0.1.0")
    sources = replace(sources, calibration=str(tmp_path / "cal.yaml"))
    put(sources, made)
    return sources, made


def proved(calibration: Calibration, *places: int) -> Calibration:
    joints = [
        replace(joint, proof=SHOWN) if place in places else joint
        for place, joint in enumerate(calibration.joints)
    ]
    return replace(calibration, joints=tuple(joints), created="2026-11-22T10:00:00Z", tool="twind 0.2.0")


def test_proofs_are_taken_and_the_file_counts_as_read(ground: tuple[ConfigSources, Calibration]) -> None:
    sources, made = ground
    old = describe(sources)
    put(sources, proved(made, 3, 5))
    found, then = reread_of(old, sources)
    names = [made.joints[place].name for place in (3, 5)]
    assert (found.changes, found.restart) == ({PROOF: dict.fromkeys(names, SHOWN)}, ())
    assert then.files == describe(sources).files, "nobody is kept from arming by it"
    assert then.calibration is not None
    assert then.calibration.by_name[names[0]].proof == SHOWN
    again, _ = reread_of(then, sources)
    assert (again.changes, again.restart) == ({}, ())


def moved(calibration: Calibration) -> Calibration:
    first, *rest = proved(calibration, 3).joints
    return replace(calibration, joints=(replace(first, zero_ticks=first.zero_ticks + 1), *rest))


def one_fewer(calibration: Calibration) -> Calibration:
    return replace(calibration, joints=proved(calibration, 3).joints[1:])


def other_device(calibration: Calibration) -> Calibration:
    first, *rest = proved(calibration, 3).joints
    return replace(calibration, joints=(replace(first, device=replace(first.device, firmware=47)), *rest))


@pytest.mark.parametrize("change", [moved, one_fewer, other_device])
def test_a_calibration_that_differs_beyond_its_proofs_waits_for_a_restart_with_its_proofs(
    ground: tuple[ConfigSources, Calibration], change: Callable[[Calibration], Calibration]
) -> None:
    sources, made = ground
    old = describe(sources)
    put(sources, change(made))
    found, then = reread_of(old, sources)
    assert (found.changes, found.restart) == ({}, ("calibration",))
    assert then.calibration is old.calibration
    assert then.files == old.files, "what is not in force keeps everybody from arming"


def test_the_next_front_reports_the_new_proof(ground: tuple[ConfigSources, Calibration]) -> None:
    sources, made = ground
    before = briefed(sources)
    put(sources, proved(made, 0))
    reading = read_again(before)
    assert (list(reading.changes), list(reading.needs_restart), reading.error) == ([PROOF], [], "")
    assert reading.briefing is not None
    assert reading.briefing.calibration is not None
    assert reading.briefing.calibration["joints"][0]["proof"] == SHOWN
    assert reading.briefing.binding == before.binding


def test_the_loop_takes_it_while_the_robot_has_torque(armed: Rig) -> None:
    reply = armed.adopt({PROOF: {"l_knee": SHOWN}})
    assert reply.error is None
    assert reply.parameters == {"applied": [PROOF], "needs_restart": []}
    assert armed.loop.torque.armed
    assert armed.call(link.RenewLease).error is None
