"""Files of test vectors: what is not one row per step and number is refused, whatever its bytes."""

import contextlib
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("onnx", reason="make extras EXTRAS=learn")

from tests.support.card_files import HEAD, PLAIN, linear
from twind.exceptions import InvalidInput
from twind.learn.cards.card_actor import CardPolicy
from twind.learn.cards.interface_card import VectorSpec, parse_card
from twind.learn.cards.vector_replay import replay_vectors
from twind.learn.policy.onnx_session import OnnxSession

POLICY = CardPolicy(parse_card(HEAD + PLAIN, "x"), OnnxSession(linear(5, 2).SerializeToString()))
VECTORS = VectorSpec("v.npz")


def test_the_largest_difference_is_reported(tmp_path: Path) -> None:
    np.savez(tmp_path / "v.npz", obs=np.ones((3, 5)), actions=[[0.0, 0.0], [0.0, 0.25], [0.0, 0.0]])
    assert replay_vectors(POLICY, VECTORS, tmp_path) == (3, 0.25)


@pytest.mark.parametrize(
    ("seen", "actions"),
    [
        (np.zeros((3, 5)), np.float64(1.0)),
        (np.zeros((5, 3)), np.zeros((3, 2))),
        (np.zeros((0, 5)), np.zeros((0, 2))),
        (np.zeros((3, 5)), np.zeros(6)),
        (np.array([["a"] * 5] * 3), np.zeros((3, 2))),
    ],
)
def test_arrays_of_another_shape_or_type_are_refused(tmp_path: Path, seen: Any, actions: Any) -> None:
    np.savez(tmp_path / "v.npz", obs=seen, actions=actions)
    with pytest.raises(InvalidInput, match=r"^v\.npz: "):
        replay_vectors(POLICY, VECTORS, tmp_path)


@given(st.data())
@settings(max_examples=200, deadline=None)
def test_a_damaged_file_is_refused_or_read(data: st.DataObject) -> None:
    """Any bytes are replaced, those of sizes, flags and packing included."""
    with TemporaryDirectory() as place:
        folder = Path(place)
        np.savez_compressed(folder / "v.npz", obs=np.ones((3, 5)), actions=np.ones((3, 2)))
        content = bytearray((folder / "v.npz").read_bytes())
        for _ in range(data.draw(st.integers(1, 8))):
            content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
        (folder / "v.npz").write_bytes(content)
        with contextlib.suppress(InvalidInput):
            replay_vectors(POLICY, VECTORS, folder)
