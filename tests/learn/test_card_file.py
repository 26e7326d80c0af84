"""Policy files of other frameworks: where the card stands, and hostile files, refused in one sentence."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnx", reason="make extras EXTRAS=learn")

import onnx

from tests.support.card_files import HEAD, PLAIN, carded, linear
from tests.support.policy_files import written
from twind.ctl.ctl_main import main
from twind.exceptions import InvalidInput
from twind.learn.cards.card_actor import CardPolicy
from twind.learn.cards.card_file import load_any
from twind.learn.policy.policy_file import Policy


def test_a_card_may_stand_beside_the_network_or_in_another_folder(tmp_path: Path) -> None:
    path = carded(tmp_path, linear(5, 2), HEAD + PLAIN)
    other = tmp_path / "other.yaml"
    other.write_text(HEAD.replace("50.0", "25.0") + PLAIN)
    assert load_any(path).card.rate_hz == 50.0
    assert load_any(path, other).card.rate_hz == 25.0


def test_a_card_may_stand_inside_the_network(tmp_path: Path) -> None:
    model = linear(5, 2)
    onnx.helper.set_model_props(model, {"twind_card": HEAD + PLAIN})
    (tmp_path / "p.onnx").write_bytes(model.SerializeToString())
    policy = load_any(tmp_path / "p.onnx")
    assert isinstance(policy, CardPolicy) and policy.card.joints == ("knee", "hip")


def test_a_policy_of_twindctl_train_is_read_as_before(tmp_path: Path) -> None:
    assert isinstance(load_any(written(tmp_path)), Policy)


def test_weights_in_the_file_that_torch_writes_beside_a_network_are_read(tmp_path: Path) -> None:
    model = linear(5, 2, weight=np.arange(10).reshape(5, 2))
    onnx.save(
        model, tmp_path / "p.onnx", save_as_external_data=True, location="p.onnx.data", size_threshold=0
    )
    (tmp_path / "p.card.yaml").write_text(HEAD + PLAIN)
    policy = load_any(tmp_path / "p.onnx")
    assert isinstance(policy, CardPolicy)
    assert policy.act({"obs": np.eye(5, dtype=np.float32)[2:3]}).tolist() == [4.0, 5.0]


def outside(model: Any) -> None:
    """Store the weights in a file that is not in the folder."""
    array = model.graph.initializer[0]
    array.ClearField("raw_data")
    array.data_location = onnx.TensorProto.EXTERNAL
    for key, value in (("location", "../../../../etc/passwd"), ("offset", "0"), ("length", "40")):
        array.external_data.add(key=key, value=value)


def nan(model: Any) -> None:
    weights = np.full((5, 2), np.nan, np.float32)
    model.graph.initializer[0].CopyFrom(onnx.numpy_helper.from_array(weights, "w"))


def opset(model: Any) -> None:
    model.opset_import[0].version = 999


def integers(model: Any) -> None:
    model.graph.input[0].type.tensor_type.elem_type = 7


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (outside, "it stores arrays in another file than"),
        (nan, "its action of knee is not finite"),
        (opset, "is no ONNX model that can be run"),
        (integers, "is no ONNX model that can be run"),
    ],
)
def test_a_hostile_network_is_refused_in_one_sentence(
    tmp_path: Path, harm: Callable[[Any], None], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    model = linear(5, 2)
    harm(model)
    path = carded(tmp_path, model, HEAD + PLAIN)
    assert main(["policy", "check", str(path)]) == 1
    error = capsys.readouterr().err
    assert str(path) in error and message in error and "Traceback" not in error and error.count("\n") == 1


def test_a_file_that_is_no_network_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = carded(tmp_path, linear(5, 2), HEAD + PLAIN)
    for data in (b"", b"PK\x03\x04 no network", bytes((8 << 20) + 1)):
        path.write_bytes(data)
        assert main(["policy", "check", str(path)]) == 1
        error = capsys.readouterr().err
        assert error.startswith("twindctl: ") and "Traceback" not in error


def test_a_mistake_in_a_card_is_reported_with_its_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = carded(tmp_path, linear(5, 2), HEAD + PLAIN.replace("projected_gravity", "gravty"))
    assert main(["policy", "check", str(path)]) == 1
    assert "policy.card.yaml:5:" in capsys.readouterr().err


def test_a_network_without_a_card_is_refused_with_the_command_that_makes_one(tmp_path: Path) -> None:
    (tmp_path / "p.onnx").write_bytes(linear(5, 2).SerializeToString())
    with pytest.raises(InvalidInput, match=r"has no card: .*twindctl policy card --template"):
        load_any(tmp_path / "p.onnx")


def test_show_prints_what_the_network_receives(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = carded(tmp_path, linear(5, 2), HEAD + PLAIN)
    assert main(["policy", "show", str(path)]) == 0
    assert "input   obs [1, 5]: joint_position, projected_gravity; 1 steps" in capsys.readouterr().out
