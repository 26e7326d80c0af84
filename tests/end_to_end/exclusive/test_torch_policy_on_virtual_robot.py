"""Networks that `torch.onnx.export` wrote, with a card from a template: check, then a virtual robot."""

import json
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("torch", reason="make extras EXTRAS=learn")
pytest.importorskip("onnx", reason="make extras EXTRAS=learn")

import torch

from tests.support.policy_files import Run
from tests.support.processes import arm, daemon, robot, until
from twind.config.robot_file import load_robot
from twind.ctl.ctl_main import main
from twind.learn.cards.card_templates import template_text

ENTRIES = 3 + 3 + 3 + 3 * 24
HIDDEN = 32
STATE = "state: {h_in: {output: h_out, shape: [1, 1, 32]}, c_in: {output: c_out, shape: [1, 1, 32]}}\n"
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]


class Perceptron(torch.nn.Module):
    """An untrained actor as rsl_rl has it, with small actions."""

    def __init__(self) -> None:
        super().__init__()
        linear = torch.nn.Linear
        elu = torch.nn.ELU
        self.actor = torch.nn.Sequential(linear(ENTRIES, 128), elu(), linear(128, 64), elu(), linear(64, 24))

    def forward(self, obs: Any) -> Any:
        return 0.1 * self.actor(obs)


class Recurrent(torch.nn.Module):
    """An untrained recurrent actor, whose states are inputs and outputs."""

    def __init__(self) -> None:
        super().__init__()
        self.rnn = torch.nn.LSTM(ENTRIES, HIDDEN)
        self.actor = torch.nn.Linear(HIDDEN, 24)

    def forward(self, obs: Any, h_in: Any, c_in: Any) -> Any:
        seen, (h, c) = self.rnn(obs.unsqueeze(0), (h_in, c_in))
        return 0.2 * self.actor(seen.squeeze(0)), h, c


def exported(folder: Path, recurrent: bool) -> Path:
    torch.manual_seed(0)
    path = folder / "policy.onnx"
    card = template_text("isaaclab", load_robot("h24-standing"))
    card = "".join(line for line in card.splitlines(True) if "base_linear_velocity" not in line)
    obs = torch.zeros(1, ENTRIES)
    given: dict[str, Any] = {"input_names": ["obs"], "output_names": ["actions"]}
    arguments: tuple[Any, ...] = (obs,)
    if recurrent:
        state = torch.zeros(1, 1, HIDDEN)
        arguments = (obs, state, state.clone())
        given = {"input_names": ["obs", "h_in", "c_in"], "output_names": ["actions", "h_out", "c_out"]}
        card += STATE
    network = Recurrent() if recurrent else Perceptron()
    torch.onnx.export(network, arguments, str(path), opset_version=17, dynamo=False, **given)
    (folder / "policy.card.yaml").write_text(card)
    return path


@pytest.mark.parametrize("recurrent", [False, True])
def test_a_network_of_torch_is_checked_and_then_drives_a_virtual_robot(
    recurrent: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = exported(tmp_path, recurrent)
    assert main(["policy", "check", str(path), "--seconds", "3", "--json"]) == 0
    lines = {each["name"]: each for each in map(json.loads, capsys.readouterr().out.splitlines())}
    assert lines["drive"]["verdict"] == lines["gate"]["verdict"] == "ok"
    with robot("h24-standing") as (virtual, folder), daemon(virtual, folder) as running:
        running.reach(state="connected")
        with running.client() as client:
            arm(client)
        until(lambda: not virtual.order(query="state")["body"]["held"], 10.0, "the hands let go")
        run = Run(running, path, "--seconds", "5")
        code, told, errors = run.end()
        assert code == 0 and told["refused"] == 0 and told["most_tilt_deg"] < 20.0, (told, errors)
