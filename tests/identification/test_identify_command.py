"""`twindctl identify` on files: it writes beside the calibration, shows and compares; what it cannot use it
refuses."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.hidden_robot import goals_of, hide, record
from tests.support.sample_recordings import CLOCKS, SESSION, joint, status
from twind.config.calibration_file import load_calibration
from twind.config.identified_file import identified_path, load_identified, save_identified
from twind.config.robot_file import load_robot
from twind.ctl.ctl_main import main
from twind.gap.motion_samples import MotionSamples
from twind.observe.writing.record_encoder import RecordEncoder
from twind.observe.writing.record_file import RecordFile
from twind.twin.simulation import hush
from twind.virtual.virtual_robot_spec import make_spec, save

ROBOT = load_robot("pan-tilt")
TICKS = 1700  # of the excitation: steps and a chirp


def written(path: Path, motion: MotionSamples) -> Path:
    """Write a motion as a recording of mode live."""
    file = RecordFile(path, SESSION.about, SESSION.attachments, CLOCKS.wall_ns)
    encoder = RecordEncoder(motion.names, CLOCKS)
    answers = [status(100.0)]
    for at in range(len(motion.time)):
        rows = [
            joint(name, float(motion.position[at, place]), goal=float(motion.goal[at, place]))
            for place, name in enumerate(motion.names)
        ]
        head = {"topic": "state", "time": 100.0 + float(motion.time[at]), "sequence": at, "dropped": 0}
        answers.append(head | {"joints": rows})
    for answer in answers:
        for line in encoder.take(answer):
            file.write(line.topic, line.time_ns, line.data)
    file.finish()
    return path


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a calibration, a recording in which tilt moves, and the model identified from it."""
    hush()
    folder = tmp_path_factory.mktemp("identify")
    save(make_spec(ROBOT), folder / "mine.yaml")
    hidden = hide(ROBOT, 0)
    goals = goals_of(hidden.binding, np.zeros(2))[:TICKS, ::-1]  # pan would be the first
    written(folder / "steps.mcap", record(hidden, goals))
    return folder


@pytest.fixture(scope="module")
def model(place: Path) -> Path:
    words = ["--robot", "pan-tilt", "--calibration", str(place / "mine.yaml"), "--write"]
    assert main(["identify", str(place / "steps.mcap"), *words]) == 0
    return identified_path(place / "mine.yaml")


def test_the_model_is_written_beside_the_calibration_with_date_and_source(model: Path) -> None:
    found = load_identified(model, ROBOT)
    assert found.source == "steps.mcap"
    assert list(found.joints) == ["tilt"]
    assert found.joints["tilt"].gap is not None
    load_calibration(model.with_name("mine.yaml"), ROBOT)


def test_show_prints_the_file_and_names_what_stays_at_its_prior(
    model: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["identify", "show", str(model)]) == 0
    table = capsys.readouterr().out
    assert "pan-tilt, 20" in table
    assert "from steps.mcap" in table
    estimates = load_identified(model, ROBOT).joints["tilt"].estimates()
    for name, each in estimates.items():
        line = next(line for line in table.splitlines() if f" {name} " in line)
        assert line.endswith("not determined: prior") is not each.determined
        assert each.determined or each.value == each.prior
    assert not all(each.determined for each in estimates.values())


def test_diff_prints_changes_in_deviations(model: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = load_identified(model, ROBOT)
    delay = found.joints["tilt"].delay_s
    assert delay is not None
    late = replace(delay, value=delay.value + 4.0 * delay.sd * 2.0**0.5)
    changed = replace(found, joints={"tilt": replace(found.joints["tilt"], delay_s=late)})
    other = save_identified(changed, model.with_name("other.yaml"))
    assert main(["identify", "diff", str(model), str(other)]) == 0
    rows = {line.split()[1]: line.split()[-1] for line in capsys.readouterr().out.splitlines()}
    assert rows["delay_s"] == "+4.0"
    assert rows["stiffness_nm_per_rad"] in ("+0.0", "-")


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["steps.mcap", "--robot", "so101"], "its joints are not those of so101"),
        (["steps.mcap", "--robot", "pan-tilt", "--write"], "--write needs --robot and --calibration"),
        (["absent.mcap", "--robot", "pan-tilt"], "absent.mcap"),
        (["show", "mine.yaml"], "mine.yaml:1:"),  # a calibration is no identified model
        (["show", "absent.yaml"], "absent.yaml: cannot be read"),
        (["diff", "mine.yaml"], "two files"),
        ([], "needs recordings, or --live"),
    ],
)
def test_what_identify_cannot_use_is_refused_by_name(
    words: list[str],
    reason: str,
    place: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(place)
    assert main(["identify", *words]) != 0
    assert reason in capsys.readouterr().err


def test_a_model_of_another_robot_is_refused_at_its_place(
    model: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["identify", "show", str(model), "--robot", "so101"]) != 0
    assert "robot: identified on robot 'pan-tilt', not on 'so101'" in capsys.readouterr().err


def test_a_recording_in_which_joints_hardly_move_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hidden = hide(ROBOT, 1)
    goals = np.zeros((900, 2))
    goals[300:350, 0] = 0.1  # a single move is too little
    still = written(tmp_path / "still.mcap", record(hidden, goals))
    assert main(["identify", str(still), "--robot", "pan-tilt"]) != 0
    assert "no joint moved enough to identify it: each needs some 0.1 rad" in capsys.readouterr().err


def test_json_names_the_file_that_was_written(
    place: Path, model: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--json", "identify", "show", str(model)]) == 0
    assert json.loads(capsys.readouterr().out)["robot"] == "pan-tilt"
