"""Files read again beside what is in force: the next briefing, or a reason and nothing else."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.support.reload_rig import briefed, files
from twind.briefing import Briefing, ReloadResult
from twind.config.config_files import unpacked
from twind.exceptions import InvalidInput
from twind.front.reload_worker import BY_CLIENT, read_again, with_settings
from twind.twin import binding_transfer

YAW_ID = "head_yaw:         {id: 1, "
YAW = {YAW_ID: "head_yaw: {velocity_limit_rad_s: 0.5, id: 1, "}


@pytest.fixture(scope="module")
def start(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Briefing]:
    folder = tmp_path_factory.mktemp("robot")
    return folder, briefed(files(folder))


def encoded(reading: ReloadResult | Briefing) -> bytes:
    return msgspec.msgpack.encode(reading)


def test_unchanged_files_change_nothing_but_the_count(start: tuple[Path, Briefing]) -> None:
    folder, before = start
    files(folder)
    reading = read_again(before)
    assert (reading.changes, list(reading.needs_restart), reading.error) == ({}, [], "")
    assert reading.briefing is not None
    assert reading.briefing.generation == 1
    then = msgspec.msgpack.decode(encoded(reading.briefing), type=Briefing)  # as it travels
    kept = ("joints", "description", "binding", "mjcf", "parameters", "files", "rate_hz", "calibration")
    assert all(getattr(then, name) == getattr(before, name) for name in kept)


def test_hot_keys_are_in_the_next_briefing(start: tuple[Path, Briefing]) -> None:
    folder, before = start
    files(folder, "log_level: debug\nrate_hz: 50\n", YAW)
    reading = read_again(before)
    assert reading.changes == {"joints.head_yaw.velocity_limit_rad_s": 0.5, "log_level": "debug"}
    assert list(reading.needs_restart) == ["rate_hz"]
    then = reading.briefing
    assert then is not None
    old, new = (binding_transfer.unpacked(told.binding) for told in (before, then))
    joint = old.joint_map.place("head_yaw")
    assert (new.limits.velocity[joint], new.robot.joints[joint].velocity_limit) == (0.5, 0.5)
    assert np.array_equal(np.delete(new.limits.velocity, joint), np.delete(old.limits.velocity, joint))
    assert then.description["joints"][joint]["velocity_limit"] == 0.5
    assert (then.log_level, then.rate_hz) == ("debug", before.rate_hz)
    again = read_again(then)
    assert (again.changes, list(again.needs_restart)) == ({}, ["rate_hz"]), "once is enough"


@pytest.mark.parametrize(
    ("settings", "robot", "message"),
    [
        ("log_levle: debug\n", {}, "twind.yaml:3:1: log_levle: unknown key"),
        ("log_level: [\n", {}, "twind.yaml:4:1: not YAML"),
        ("robot: h24\n", {}, "twind.yaml:3:1: duplicate key 'robot'"),
        ("calibration: none.yaml\n", {}, "none.yaml"),
        ("log_level: debug\n", {YAW_ID: "head_yaw: {id: one, "}, "body.yaml:28:18: joints.head_yaw.id: "),
        ("log_level: debug\n", {YAW_ID: f"{YAW_ID}model_joint: no_such, "}, "no joint 'no_such'"),
    ],
)
def test_a_refused_file_changes_nothing_and_reports_its_position(
    start: tuple[Path, Briefing], settings: str, robot: dict[str, str], message: str
) -> None:
    folder, before = start
    as_it_was = encoded(before)
    files(folder, settings, robot)
    reading = read_again(before)
    assert message in reading.error
    assert (reading.changes, reading.briefing) == ({}, None)
    assert encoded(before) == as_it_was


def test_files_that_vanish_change_nothing(start: tuple[Path, Briefing]) -> None:
    folder, before = start
    files(folder)
    (folder / "body.yaml").unlink()
    assert "body.yaml" in read_again(before).error
    (folder / "twind.yaml").unlink()
    assert "twind.yaml" in read_again(before).error


def test_a_front_without_file_information_reloads_nothing(start: tuple[Path, Briefing]) -> None:
    blank = msgspec.structs.replace(start[1], described=b"")
    assert "nothing is known" in read_again(blank).error


def test_a_parameter_set_by_a_client_is_shown_as_its_own_until_a_reload(
    start: tuple[Path, Briefing],
) -> None:
    folder, before = start
    files(folder)
    then = with_settings(before, {"thresholds.latency_warn_ms": 20.0, "log_level": "error"})
    assert (then.parameters["latency_warn_ms"], then.log_level) == (20.0, "error")
    origins = then.parameters["origins"]
    assert origins["latency_warn_ms"] == origins["log_level"] == BY_CLIENT
    assert origins["mode"].endswith("twind.yaml")
    assert then.binding == before.binding
    reading = read_again(then)
    assert reading.changes == {"thresholds.latency_warn_ms": 50.0, "log_level": "info"}
    assert reading.briefing is not None
    assert reading.briefing.parameters["origins"] == before.parameters["origins"]
    with pytest.raises(InvalidInput):
        with_settings(before, {"thresholds.latency_warn_ms": 51.0})
    assert unpacked(before.described)[1].settings.latency_warn_ms == 50.0


def test_gains_set_by_a_client_keep_those_of_the_file_beside_them(start: tuple[Path, Briefing]) -> None:
    folder, before = start
    files(folder)
    key = "types.xm430.gains"
    of_file = {"p": 1600, "i": 0, "d": 0}
    once = with_settings(before, {key: {"p": 900, "i": 0, "d": 0}})
    twice = with_settings(once, {key: {"p": 700, "i": 0, "d": 50}})
    assert once.replaced_gains == twice.replaced_gains == {key: of_file}
    assert twice.description["joints"][0]["type"]["gains"] == {"p": 700, "i": 0, "d": 50}
    assert binding_transfer.unpacked(twice.binding).robot.joints[0].type.gains.p == 700
    assert with_settings(twice, {key: of_file}).replaced_gains == {}
    reading = read_again(twice)
    assert reading.changes == {key: of_file}
    assert reading.briefing is not None and reading.briefing.replaced_gains == {}
