"""`twindctl dataset` with LeRobot itself: what it writes, LeRobot loads again.

`TWIND_LEROBOT` names the folder of programs of an environment, made as integrations/lerobot/README.md says.
"""

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.dataset_recordings import record_episodes
from tests.support.sample_recordings import JOINTS
from twind.observe.recording import open_recording

PROGRAMS = os.environ.get("TWIND_LEROBOT", "")
pytestmark = pytest.mark.skipif(
    not PROGRAMS, reason="TWIND_LEROBOT names no environment with lerobot and lerobot_robot_twind"
)
LOAD = """
import json, sys
from lerobot.datasets.lerobot_dataset import LeRobotDataset
dataset = LeRobotDataset("twind/two", root=sys.argv[1])
rows = [{name: each if name == "task" else each.tolist() for name, each in row.items()} for row in dataset]
meta = dataset.meta
print(json.dumps({"features": dataset.features, "rows": rows, "robot": meta.robot_type, "fps": meta.fps,
    "episodes": meta.total_episodes, "mean": meta.stats["action"]["mean"].tolist()}))
"""


def run(program: str, *arguments: str) -> str:
    environment = {**os.environ, "HF_HUB_OFFLINE": "1"}
    command = [str(Path(PROGRAMS) / program), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300.0, env=environment)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_episodes(tmp_path_factory.mktemp("recorded"))


def load(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(run("python", "-c", LOAD, str(folder)).splitlines()[-1])
    return found


def test_lerobot_loads_every_value_of_the_recording_in_degrees(recorded: Path, tmp_path: Path) -> None:
    run("twindctl", "dataset", str(recorded), "--out", str(tmp_path / "set"))
    loaded = load(tmp_path / "set")
    assert (loaded["robot"], loaded["fps"], loaded["episodes"], len(loaded["rows"])) == ("two", 50, 4, 400)
    for name in ("observation.state", "action"):
        assert loaded["features"][name]["names"] == [f"{joint}.pos" for joint in JOINTS]
    of = open_recording(recorded)
    columns = {
        "observation.state": np.degrees(of.measured),
        "observation.velocity": np.degrees(of.velocity),
        "observation.effort": of.effort,
        "action": np.degrees(of.goal),
    }
    for number in range(4):
        rows = loaded["rows"][100 * number : 100 * number + 100]
        reading = [300 * number + 2 * k for k in range(100)]  # 50 of 100 a second
        for name, column in columns.items():
            np.testing.assert_allclose([each[name] for each in rows], column[reading], rtol=1e-6, atol=1e-5)
        np.testing.assert_allclose([each["timestamp"] for each in rows], np.arange(100) / 50, atol=1e-6)
        assert [k for k, each in enumerate(rows) if each["next.done"]] == [99]
        assert {each["episode_index"] for each in rows} == {number}
    assert [each["task"] for each in loaded["rows"][::100]] == ["pick", "put", "pick", "pick"]
    actions = np.array([each["action"] for each in loaded["rows"]])
    np.testing.assert_allclose(loaded["mean"], actions.mean(axis=0), rtol=1e-4)
    assert "next.success" not in loaded["features"]  # one episode is marked neither way


def test_success_is_a_column_where_every_episode_has_it(recorded: Path, tmp_path: Path) -> None:
    run("twindctl", "dataset", str(recorded), "--out", str(tmp_path / "set"), "--only-success")
    rows = load(tmp_path / "set")["rows"]
    assert [k for k, each in enumerate(rows) if each["next.success"]] == [99, 199]
