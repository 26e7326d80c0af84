"""`twindctl calibrate import` beside a daemon: a robot that somebody else calibrated goes at once."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.calibration_bench import ROBOT, Bench, Captured, benched, json_lines
from tests.support.processes import arm
from twind.config.calibration_file import Calibration, load_calibration

# Somebody wrote homing offsets, and the limits of one joint.
TRUTH = {
    "joints": {
        "l_knee": {"homing_offset": 300},
        "l_ankle_roll": {"registers": {"min_position_limit": 0, "max_position_limit": 4095}},  # as delivered
        "r_knee": {"homing_offset": -250},
        "head_yaw": {
            "registers": {"min_position_limit": 1000, "max_position_limit": 3100},
            "zero_ticks": 2050,
        },
    }
}
RESET = 120  # the offset that l_elbow had when LeRobot measured it; the servo has none by now


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    truth = tmp_path_factory.mktemp("truth") / "truth.json"
    truth.write_text(json.dumps(TRUTH))
    with benched("--truth", str(truth)) as made:
        yield made


def lerobot(known: Calibration, *names: str) -> dict[str, dict[str, int]]:
    """File that LeRobot would write for these joints, with its own names."""
    found = {}
    for entry in known.joints:
        moved = RESET if entry.name == "l_elbow" else 0
        offset = entry.device.homing_offset_ticks + moved
        low, high = (end + moved for end in entry.sweep_ticks)
        motor = {"drive_mode": 0, "homing_offset": offset, "range_min": low, "range_max": high}
        if not names or entry.name in names:
            found[f"motor_{entry.id}"] = {"id": entry.id, **motor}
    return found


def at(known: Calibration) -> list[str]:
    """Count of LeRobot at angle 0."""
    moved = {"l_elbow": RESET}
    return [f"--zero-at={each.name}={each.zero_ticks + moved.get(each.name, 0)}" for each in known.joints]


def test_a_lerobot_file_is_converted_to_the_count_and_the_robot_moves(
    bench: Bench, capsys: Captured, tmp_path: Path
) -> None:
    known = load_calibration(bench.virtual.calibration, ROBOT)
    path = tmp_path / "lerobot.json"
    path.write_text(json.dumps(lerobot(known)))
    source = ["import", "--from", "lerobot", "--file", str(path), "--yes", "--json", "--wide"]

    assert bench.verb(*source, *at(known), "l_elbow") == 1  # its offset is another one by now
    (row, _) = json_lines(capsys.readouterr().out)
    assert "`--make dynamixel` folds it in" in row["wrong"][0]
    assert not bench.file.exists()

    assert bench.verb(*source, *at(known), "--make", "dynamixel") == 0
    *rows, last = json_lines(capsys.readouterr().out)
    assert last["written"] == str(bench.file)
    assert [row["joint"] for row in rows] == list(ROBOT.names)
    made = load_calibration(bench.file, ROBOT)
    for mine, theirs in zip(made.joints, known.joints, strict=True):
        assert (mine.zero_ticks, mine.sweep_ticks) == (theirs.zero_ticks, theirs.sweep_ticks), mine.name
        assert (mine.device, mine.method) == (theirs.device, "import")
    assert made.method_default == "import"
    bench.restart("live")
    with bench.daemon.client() as client:
        arm(client)
        client.call("Disarm")


def test_a_servos_own_limits_are_imported_where_they_differ_from_the_default(
    bench: Bench, capsys: Captured
) -> None:
    assert bench.verb("import", "--from", "servo", "--zero-at", "2050", "--yes", "head_yaw") == 0
    assert "ok   head_yaw zero at   2050, travel 1000..3100" in capsys.readouterr().out
    assert load_calibration(bench.file, ROBOT).by_name["head_yaw"].sweep_ticks == (1000, 3100)
    assert bench.verb("import", "--from", "servo", "--zero-at", "2048", "--yes", "l_ankle_roll") == 1
    said = capsys.readouterr()
    assert "a whole turn, as delivered: `twindctl" in said.out
    assert "nothing was written" in said.err


def test_a_map_names_motors_and_leaves_some_out(bench: Bench, capsys: Captured, tmp_path: Path) -> None:
    known = load_calibration(bench.virtual.calibration, ROBOT)
    motors = lerobot(known, "l_knee", "r_knee")
    path = tmp_path / "lerobot.json"
    names = tmp_path / "map.yaml"
    path.write_text(json.dumps(motors))
    left, right = (f"motor_{known.by_name[name].id}" for name in ("l_knee", "r_knee"))
    names.write_text(f"{left}: l_knee\n{right}: null\n")
    source = ["import", "--from", "lerobot", "--file", str(path), "--map", str(names), "--yes"]
    assert bench.verb(*source, *at(known)) == 0
    out = capsys.readouterr().out
    assert "ok   l_knee zero at" in out and "homing offset 300 kept" in out and "r_knee" not in out
    names.write_text(f"{left}: r_knee\n{right}: null\n")
    assert bench.verb(*source, *at(known)) == 1
    assert "has id 16, and r_knee has id" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "code", "why"),
    [
        (["--from", "servo"], 2, "--zero-at"),
        (["--from", "feetech", "--zero-at", "0"], 2, "invalid choice"),
        (["--from", "servo", "--zero-at", "2048.5"], 2, "is not TICKS"),
        (["--from", "servo", "--zero-at", "inf"], 2, "is not TICKS"),
        (["--from", "servo", "--zero-at", "=3"], 2, "is not TICKS"),
        (["--from", "servo", "--zero-at", "1", "--file", "x"], 2, "--from servo none"),
        (["--from", "lerobot", "--zero-at", "1"], 2, "takes a --file"),
        (["--from", "servo", "--zero-at", "1", "--map", "x"], 2, "--map goes with"),
        (["--from", "lerobot", "--file", "/nowhere.json", "--zero-at", "1", "--yes"], 1, "/nowhere.json"),
        (["--from", "servo", "--zero-at", "l_kne=1", "--yes"], 1, "nearest: l_knee"),
        (["--from", "servo", "--zero-at", "l_knee=1", "--yes", "l_hip_yaw"], 1, "nothing was written"),
    ],
)
def test_an_invalid_argument_is_reported(
    bench: Bench, capsys: Captured, words: list[str], code: int, why: str
) -> None:
    before = bench.file.read_bytes() if bench.file.exists() else b""
    try:
        got = bench.verb("import", *words)
    except SystemExit as error:  # of argparse
        got = int(error.code or 0)
    assert (got, why in capsys.readouterr().err) == (code, True)
    assert (bench.file.read_bytes() if bench.file.exists() else b"") == before
