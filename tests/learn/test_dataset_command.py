"""`twindctl dataset` with a stand-in for LeRobot's writer; the real one: test_lerobot_dataset.py."""

import json
import sys
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tests.support.dataset_recordings import record_episodes
from twind.ctl.ctl_main import main
from twind.learn.dataset import dataset_command
from twind.learn.dataset.episode_collection import DatasetContents

Writer = Callable[[DatasetContents, Path], None]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_episodes(tmp_path_factory.mktemp("recorded"))


@pytest.fixture
def install_writer(monkeypatch: pytest.MonkeyPatch) -> Callable[[Writer], None]:
    """Replace the writer of the plug-in, whether or not it is installed."""

    def replace(write: Writer) -> None:
        module = ModuleType("lerobot_robot_twind.dataset_writer")
        module.write = write  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "lerobot_robot_twind", ModuleType("lerobot_robot_twind"))
        monkeypatch.setitem(sys.modules, module.__name__, module)
        monkeypatch.setattr(dataset_command, "find_spec", lambda name: find_spec("json"))

    replace(write_frames)
    return replace


def write_frames(contents: DatasetContents, folder: Path) -> None:
    folder.mkdir()
    (folder / "frames").write_text(str(contents.frames))


def verb(out: Path, *words: str | Path) -> int:
    return main(["dataset", *map(str, words), "--out", str(out)])


@pytest.mark.usefixtures("install_writer")
def test_nothing_is_written_over_or_added_to(recorded: Path, tmp_path: Path, capsys: Any) -> None:
    (tmp_path / "set").mkdir()
    assert verb(tmp_path / "set", recorded) == 0  # an empty folder is nothing
    assert verb(tmp_path / "set", recorded, "--fps", "25") == 1
    assert "is there already, and nothing is added to it" in capsys.readouterr().err
    assert [each.name for each in tmp_path.iterdir()] == ["set"]
    assert (tmp_path / "set" / "frames").read_text() == "400"


@pytest.mark.parametrize(
    ("error", "code"), [(KeyboardInterrupt(), 130), (OSError(28, "No space left on device"), 1)]
)
def test_an_interrupted_export_leaves_no_file(
    recorded: Path,
    tmp_path: Path,
    error: BaseException,
    code: int,
    install_writer: Callable[[Writer], None],
) -> None:
    def stop(contents: DatasetContents, folder: Path) -> None:
        write_frames(contents, folder)
        assert [each.name for each in tmp_path.iterdir()] == [folder.name] != ["set"]
        raise error

    install_writer(stop)
    assert verb(tmp_path / "set", recorded) == code
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("install_writer")
def test_a_refused_request_leaves_no_file(recorded: Path, tmp_path: Path, capsys: Any) -> None:
    assert verb(tmp_path / "set", recorded, "--fps", "500") == 1
    assert "--fps at most 100" in capsys.readouterr().err and not list(tmp_path.iterdir())


def test_a_missing_plugin_is_reported_with_its_install_command(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(dataset_command, "find_spec", lambda name: None)
    monkeypatch.setattr(dataset_command, "clone", lambda: Path("/src/twind"))
    assert verb(tmp_path / "set", recorded) == 2
    assert capsys.readouterr().err == (
        "twindctl: dataset needs LeRobot with the package lerobot_robot_twind: in LeRobot's environment, "
        "python -m pip install /src/twind /src/twind/integrations/lerobot\n"
    )


@pytest.mark.usefixtures("install_writer")
@pytest.mark.parametrize("words", [["--fps", "0"], ["--gap", "0"], ["--gap", "nan"]])
def test_figures_that_mean_nothing_are_a_usage_error(
    recorded: Path, tmp_path: Path, words: Sequence[str]
) -> None:
    assert verb(tmp_path / "set", recorded, *words) == 2


@pytest.mark.usefixtures("install_writer")
def test_the_dataset_result_is_printed_as_json_on_request(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--json", "dataset", str(recorded), "--out", str(tmp_path / "set"), "--only-success"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert (data["episodes"], data["frames"], data["tasks"]) == (2, 200, ["pick"])
    assert [(each["recording"], each["time"]) for each in data["sources"]] == [
        (recorded.name, 0.0),
        (recorded.name, 9.0),
    ]
    assert [each["why"] for each in data["left_out"]] == ["not marked as a success"] * 2
