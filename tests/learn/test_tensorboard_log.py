"""`train --tensorboard-log`: logs under the names that users of Stable-Baselines3 know."""

from pathlib import Path

import pytest

pytest.importorskip("stable_baselines3", reason="make extras EXTRAS=learn")

from tests.support.trainer_rig import TINY
from twind.ctl.ctl_main import main
from twind.learn.training import train_command


@pytest.mark.slow
def test_the_logs_have_rollout_train_and_evaluation(tmp_path: Path) -> None:
    pytest.importorskip("tensorboard", reason="make extras EXTRAS=tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    logs = tmp_path / "logs"
    command = ["train", "stand", *TINY, "--out", str(tmp_path / "run"), "--tensorboard-log", str(logs)]
    assert main(command) == 0
    found = EventAccumulator(str(logs))
    found.Reload()
    names = set(found.Tags()["scalars"])
    assert {"train/loss", "train/approx_kl", "time/fps", "eval/mean_reward", "eval/mean_ep_length"} <= names
    assert [each.step for each in found.Scalars("eval/mean_reward")][-1] == 128


def test_without_tensorboard_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = train_command.find_spec
    monkeypatch.setattr(
        train_command, "find_spec", lambda name: None if name == "tensorboard" else found(name)
    )
    assert main(["train", "stand", "--out", str(tmp_path / "run"), "--tensorboard-log", str(tmp_path)]) == 2
    assert "--tensorboard-log needs tensorboard: " in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
