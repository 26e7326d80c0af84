"""`twindctl train`: what is learnt outlives kills, goes on as it was, and is in the file as it is."""

import json
import os
import threading
from argparse import Namespace
from contextlib import suppress
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.trainer_rig import TINY, course

# Tests that train import it: two seconds that the other tests' worker need not take.
if find_spec("stable_baselines3") is None:
    pytest.skip("make extras EXTRAS=learn", allow_module_level=True)

from tests.support import trained_policy as trained
from twind.command_line.progress import ProgressLine
from twind.command_line.verb import Rejected
from twind.config.robot_file import load_robot
from twind.ctl.ctl_main import main
from twind.learn.policy.policy_file import load
from twind.learn.training.evaluation import EvaluationEnvs, EvaluationScore
from twind.learn.training.learning_curve_figure import figure
from twind.learn.training.ppo_learner import PpoLearner, export
from twind.learn.training.trainer import Trainer
from twind.learn.training.training_folder import (
    BEST,
    CHECKPOINT,
    CURVE,
    LAST,
    RUN,
    TrainingFolder,
    lock_folder,
    read_run,
)
from twind.learn.training.training_reporter import TrainingReporter
from twind.learn.training.training_settings import (
    TrainingSettings,
    describe_changes,
    differences,
    make_settings,
    originated,
)

SMALL = TrainingSettings("Stand", steps=128, envs=2, rollout=32, batch=32, epochs=2, hidden=(16,), episodes=2)
SMALL = replace(SMALL, evaluate_every=64)
QUICK = (*TINY, "--evaluate-every", "64")


def parameters(learner: PpoLearner) -> list[Any]:
    return [each.detach().numpy().copy() for each in learner.model.policy.parameters()]


def same(one: list[Any], other: list[Any]) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


@pytest.fixture(scope="module")
def learnt() -> PpoLearner:
    """After one update."""
    learner = PpoLearner(SMALL)
    learner.update()
    return learner


def test_the_help_lists_the_default_values(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["train", "--help"])
    text = " ".join(capsys.readouterr().out.split())
    for default in (
        "61440; humanoid: 2000000; walk: 2000000",
        "0.95; humanoid: 0.99; walk: 0.99",
        "64,64; walk: 128,128",
    ):
        assert f"(default: {default})" in text


@pytest.fixture(scope="module")
def file(learnt: PpoLearner, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The policy file of that update."""
    made = tmp_path_factory.mktemp("file") / "p.onnx"
    export(made, learnt.model, SMALL, EvaluationEnvs(SMALL, episodes=1).core, {"return": 1.0})
    return made


def test_the_policy_file_acts_as_what_was_trained(learnt: PpoLearner, file: Path) -> None:
    import onnxruntime

    normal = learnt.model.get_vec_normalize_env()
    spread = np.sqrt(normal.obs_rms.var)
    rows = np.random.default_rng(1).normal(normal.obs_rms.mean, 8.0 * spread + 0.01, (200, 128))
    rows = rows.astype(np.float32)
    expected = learnt.model.predict(normal.normalize_obs(rows), deterministic=True)[0]
    assert np.abs(expected).max() > 1e-3  # else all would be the same
    assert load(file).act(rows) == pytest.approx(expected, abs=1e-5)
    session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
    assert session.run(None, {"observation": rows})[0] == pytest.approx(expected, abs=1e-5)


def test_a_policy_card_records_task_robot_and_training(file: Path) -> None:
    card = load(file).card
    assert (card.task, card.robot, card.trained_steps, card.rate_hz) == ("Stand", "h24", 64, 50.0)
    assert card.notes == {"seed": "0", "profile": "none"}
    assert card.evaluation == {"return": 1.0}


def test_a_checkpoint_holds_network_optimiser_normalisation_and_steps(learnt: PpoLearner) -> None:
    again = PpoLearner(SMALL, learnt.state())
    assert again.steps == learnt.steps == 64
    assert same(parameters(again), parameters(learnt))
    for name in ("obs_rms", "ret_rms"):
        mine, yours = (getattr(each.model.get_vec_normalize_env(), name) for each in (again, learnt))
        assert np.array_equal(mine.mean, yours.mean)
        assert np.array_equal(mine.var, yours.var)
        assert mine.count == yours.count
    moments = [each.model.policy.optimizer.state_dict()["state"] for each in (again, learnt)]
    assert len(moments[0]) == len(moments[1]) > 0
    assert all(same([one["exp_avg"]], [moments[1][key]["exp_avg"]]) for key, one in moments[0].items())
    again.close()


@pytest.mark.parametrize("resumed", [True, False])
def test_the_seed_decides_how_a_training_begins_and_how_it_goes_on(learnt: PpoLearner, resumed: bool) -> None:
    state = learnt.state() if resumed else None
    ways = []
    for seed in (3, 3, 4):
        learner = PpoLearner(replace(SMALL, seed=seed), state)
        learner.update()
        assert learner.steps == (128 if resumed else 64)
        ways.append(parameters(learner))
        learner.close()
    assert same(ways[0], ways[1])
    assert not same(ways[0], ways[2])


def test_a_checkpoint_that_is_none_is_refused(learnt: PpoLearner) -> None:
    for state in (b"", b"nonsense", learnt.state()[:-200]):
        with pytest.raises(ValueError, match="cannot go on from it"):
            PpoLearner(SMALL, state)


@pytest.mark.parametrize("kind", ["dummy", pytest.param("subproc", marks=pytest.mark.slow)])
def test_other_kinds_of_environments_learn_too(kind: str) -> None:
    learner = PpoLearner(replace(SMALL, kind=kind))
    learner.update()
    assert learner.steps == 64
    learner.close()


def test_the_same_policy_is_judged_the_same_every_time() -> None:
    trials = EvaluationEnvs(SMALL, episodes=3)
    first = trials.zero()
    moving = trials.judge(lambda rows: np.tanh(rows[:, :24]))
    assert trials.zero() == first
    assert moving != first
    assert first.jitter == 0.0 < moving.jitter
    assert first.episodes == 3
    assert first.longest == 500


# ------------------------------------------------------------------------------------- the verb


def test_a_training_leaves_policies_curve_and_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    assert main(["train", "stand", *QUICK, "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "against zero" in said
    assert "done after 128 steps" in said
    settings, data = read_run(out)
    assert settings.steps == data["steps"] == 128
    assert data["ended"] == "done"
    assert [each["steps"] for each in data["evaluations"]] == [64, 128]
    best = max(each["returns"] for each in data["evaluations"])
    assert data["best"]["returns"] == best == load(out / BEST).card.evaluation["return"]
    assert load(out / LAST).card.trained_steps == 128
    assert (out / CURVE).read_bytes().startswith(b"\x89PNG")
    assert {"torch", "stable-baselines3", "twind"} <= set(data["versions"])
    assert not list(out.glob(".*.new")) + list(out.glob("candidate*"))


@pytest.mark.slow
def test_json_is_a_line_for_each_thing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "--json", "stand", *QUICK, "--out", str(tmp_path / "run")]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    kinds = [each["event"] for each in lines]
    assert kinds == ["began", "progress", "evaluated", "progress", "evaluated", "ended"]
    assert lines[0]["zero"]["falls"] >= 0.0
    assert lines[-1]["done"] is True


@pytest.mark.slow
def test_more_steps_may_be_asked_for_and_nothing_else(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    assert main(["train", "stand", *QUICK, "--out", str(out)]) == 0
    assert main(["train", "humanoid", "--resume", str(out), "--envs", "4", "--gamma", "0.9"]) == 1
    said = capsys.readouterr().err
    for what in ("task is Stand, not Humanoid", "envs is 2, not 4", "gamma is 0.95, not 0.9"):
        assert what in said
    assert main(["train", "--resume", str(out), "--steps", "192"]) == 0
    assert main(["train", "--resume", str(out)]) == 0  # there is nothing left to do
    settings, data = read_run(out)
    assert settings.steps == 192
    assert data["ended"] == "done"
    assert [each["steps"] for each in data["evaluations"]] == [64, 128, 192]


def test_a_robot_or_ranges_that_changed_since_are_noticed(tmp_path: Path) -> None:
    """Also where a calibration would not care: limits, gains, the MJCF."""
    robot = load_robot("h24")
    mjcf = tmp_path / "h24.xml"
    mjcf.write_text(robot.mjcf)
    file = tmp_path / "h24.yaml"
    ranges = tmp_path / "ranges.yaml"
    file.write_text(robot.path.read_text())
    ranges.write_text("format: twind-ranges/1\nprofiles:\n  default: {friction: [0.5, 1.25]}\n")
    began = originated(replace(SMALL, robot=str(file), profile=str(ranges)))
    assert describe_changes(began) == []
    ranges.write_text(ranges.read_text().replace("0.5", "0.1"))
    assert describe_changes(began) == [f"the ranges of {ranges} have changed since"]
    mjcf.write_text(robot.mjcf.replace('kp="38"', 'kp="12"'))
    assert mjcf.read_text() != robot.mjcf
    assert describe_changes(began)[0] == f"the robot file {file} or its MJCF has changed since"


def test_a_training_that_cannot_begin_leaves_no_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for profile in ("nope", str(tmp_path / "nope.yaml")):
        assert main(["train", "stand", "--profile", profile, "--out", str(tmp_path / "run")]) == 1
        assert "nope" in capsys.readouterr().err
        assert not (tmp_path / "run").exists()


def test_a_training_folder_in_use_or_of_another_format_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    with lock_folder(out):
        assert main(["train", "stand", "--out", str(out)]) == 1
        assert f"a training is running there (process {os.getpid()})" in capsys.readouterr().err
        (out / RUN).write_text("{}")
    assert main(["train", "stand", "--out", str(out)]) == 1
    assert f"--resume {out} goes on with it" in capsys.readouterr().err
    assert main(["train", "--resume", str(out)]) == 1
    assert "is no twind-run/1" in capsys.readouterr().err


def test_an_invalid_training_option_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for asked, said in (
        (["sit"], "no task 'sit': Stand, Humanoid"),
        ([], "name a TASK"),
        (["stand", "--steps", "0"], "steps 0: at least 1"),
        (["stand", "--std", "-1"], "std -1: above 0"),
        (["stand", "--gamma", "5"], "gamma 5: above 0 and below 1"),
        (["stand", "--gamma", "nan"], "gamma nan: above 0 and below 1"),
        (["stand", "--seed", "99999999999"], "seed 99999999999: 0 to 4294967295"),
    ):
        assert main(["train", *asked, "--out", str(tmp_path / "run")]) == 2
        assert said in capsys.readouterr().err
        assert not (tmp_path / "run").exists()
    with pytest.raises(ValueError, match="gae lambda 2: above 0 and at most 1"):
        replace(SMALL, gae_lambda=2.0)
    assert main(["train", "stand", "--robot", str(tmp_path / "none.yaml")]) == 1
    assert "none.yaml" in capsys.readouterr().err
    assert main(["train", "--resume", str(tmp_path / "nowhere")]) == 1
    assert not (tmp_path / "nowhere").exists()


@pytest.mark.slow
def test_an_interrupted_training_leaves_a_checkpoint_that_can_be_resumed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stop = threading.Event()
    options = Namespace(json=False)

    class Once(ProgressLine):
        """Told to stop while the first update is told."""

        def update(self, text: str, share: float | None = None) -> None:
            if share:
                stop.set()

    with lock_folder(tmp_path) as folder:
        course = Trainer(originated(SMALL), folder, TrainingReporter(options), None)
        assert not course.run(stop, Once(options, "train"))
        course.close()
    assert f"twindctl train --resume {tmp_path} goes on with it" in capsys.readouterr().out
    assert (read_run(tmp_path)[1]["ended"], read_run(tmp_path)[1]["steps"]) == ("stopped", 64)
    assert main(["train", "--resume", str(tmp_path)]) == 0
    assert (read_run(tmp_path)[1]["ended"], read_run(tmp_path)[1]["steps"]) == ("done", 128)


@pytest.mark.slow
@pytest.mark.parametrize("last", [RUN, CHECKPOINT, None])
def test_killed_at_any_moment_of_keeping_the_best_policy_is_that_of_the_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, last: str | None
) -> None:
    """Killed after `last` was written, at the second evaluation, which is the best; then taken up."""
    judged: list[float] = []

    def judge(trials: EvaluationEnvs, act: Any) -> EvaluationScore:
        judged.append([1.0, 2.0, 0.0][len(judged)])
        return EvaluationScore(judged[-1], 0.0, 1.0, 500, 0.0, 0.0, 0.0, 2)

    def write(folder: TrainingFolder, name: str, data: bytes) -> Path:
        made = folder.make(name, lambda beside: beside.write_bytes(data))
        if len(judged) == 2 and name == last:
            raise KeyboardInterrupt
        return made

    monkeypatch.setattr(
        EvaluationEnvs, "zero", lambda trials: EvaluationScore(0.0, 0.0, 1.0, 500, 0.0, 0.0, 0.0, 2)
    )
    monkeypatch.setattr(EvaluationEnvs, "judge", judge)
    with lock_folder(tmp_path) as folder:
        with monkeypatch.context() as killed, suppress(KeyboardInterrupt):
            killed.setattr(TrainingFolder, "write", write)
            course(folder, SMALL)
        course(folder, SMALL, read_run(tmp_path)[1])
    best = read_run(tmp_path)[1]["best"]
    assert load(tmp_path / BEST).card.evaluation["return"] == best["returns"]
    assert load(tmp_path / BEST).card.trained_steps == best["steps"]


def test_a_failed_write_leaves_the_previous_file(tmp_path: Path) -> None:
    def half(beside: Path) -> None:
        beside.write_bytes(b"ha")
        raise OSError("the disk is full")

    with lock_folder(tmp_path) as folder:
        folder.write(CHECKPOINT, b"whole")
        with pytest.raises(OSError, match="full"):
            folder.make(CHECKPOINT, half)
    assert (tmp_path / CHECKPOINT).read_bytes() == b"whole"
    assert not list(tmp_path.glob("*.new")) + list(tmp_path.glob(".*.new"))


def test_a_run_without_its_checkpoint_is_refused(tmp_path: Path) -> None:
    with lock_folder(tmp_path) as folder, pytest.raises(Rejected, match="nothing to go on from"):
        Trainer(SMALL, folder, TrainingReporter(Namespace(json=True)), {"evaluations": [], "seconds": 0.0})


def test_only_explicitly_given_settings_count_as_differences() -> None:
    before = make_settings("Stand", {"seed": 3})
    assert not differences(before, {"task": "Stand", "seed": 3, "steps": before.steps + 1})
    assert differences(before, {"steps": 10}) == [f"steps is {before.steps}, not 10"]
    assert differences(before, {"profile": "default"}) == ["profile is none, not default"]


def test_the_curve_has_both_policies_in_every_panel() -> None:
    zero = EvaluationScore(100.0, 20.0, 250.0, 500, 0.8, 0.0, 0.0, 20)
    points = [(1000 * k, replace(zero, returns=100.0 + 50.0 * k, falls=0.8 - 0.2 * k)) for k in (1, 2, 3)]
    made = figure("Stand", zero, points, 3000)
    assert len(made.axes) == 3
    for panel, ours, theirs in zip(made.axes, (250.0, 250.0, 20.0), (100.0, 250.0, 80.0), strict=True):
        lines = {line.get_label(): line.get_ydata() for line in panel.get_lines()}
        assert lines["trained"][-1] == pytest.approx(ours)
        assert lines["zero policy"][0] == pytest.approx(theirs)


# Times the zero policy's, on the same 64 episodes, none of which training or its evaluations had.
MARGIN = 1.2
LEAN = -0.08  # of both ankle_pitch, always: the best of what sees nothing


@pytest.mark.campaign
def test_stand_is_learnt_from_scratch_far_beyond_the_zero_policy(request: pytest.FixtureRequest) -> None:
    """The same file then stands on the virtual robot, over the bus and through the gate.

    A constant lean does that too: nothing here says that feedback was learnt.
    """
    trials = EvaluationEnvs(trained.settings(), episodes=64, first_seed=2_000_000)
    zero = trials.zero()
    learnt = trials.judge(load(trained.policy(request.config)).act)
    assert zero.falls > 0.5  # else there would be little to learn
    assert learnt.returns > MARGIN * zero.returns
    assert learnt.length > MARGIN * zero.length
    assert learnt.falls < zero.falls - 0.2
    assert learnt.jitter < 0.005  # of the whole reach, a step: 2.5 mrad
    names = trials.core.plant.layout.joints
    lean = np.array([[LEAN * name.endswith("ankle_pitch") for name in names]] * 64, np.float32)
    blind = trials.judge(lambda _: lean)
    assert blind.returns > MARGIN * zero.returns  # no more so: then say what was learnt, here and in docs
