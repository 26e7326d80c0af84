"""A policy in a file: ONNX with its normalisation baked in, and a card that says what it was made for.

A file may come from anybody: its size is bounded before it is read, no library but numpy sees it, no other
file is opened for it, and only a chain of operations runs whose work is known before: `onnx_reader.py`,
`chain_inference.py`.
"""

import os
import stat
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from twind.exceptions import InvalidInput
from twind.learn.policy import chain_inference, onnx_writer
from twind.learn.policy import policy_card as cards
from twind.learn.policy.onnx_reader import parsed
from twind.learn.policy.onnx_writer import INPUT, OUTPUT, NetworkLayer, Rows
from twind.learn.policy.policy_card import PolicyCard

LARGEST = 8 << 20  # bytes of a file; the network of 24 joints has half a megabyte
KEY = "twind"  # of the card in `metadata_props`
Step = Callable[[Rows], Rows]

__all__ = ["InvalidInput", "NetworkLayer", "Policy", "PolicyCard", "load", "save"]


class Policy:
    """What a file holds, ready to run. Not for several threads at once."""

    def __init__(self, card: PolicyCard, make: Callable[[int | None], Step]) -> None:
        """`make`: the function for an observation (N,) (None) or for that many of them."""
        self.card = card
        self._make = make
        self._rows = -1
        self._one = make(None)
        self._many = make(None)

    def act(self, observation: Rows) -> Rows:
        """The action (n,) for an observation (N,), or (batch, n) for (batch, N). A new array, float32.

        NaN where the network makes NaN. Raises ValueError for another shape.
        """
        count = self.card.observations
        if observation.shape[-1:] != (count,) or observation.ndim > 2:
            raise ValueError(f"observation {observation.shape}: ({count},) or (batch, {count}) is needed")
        value = np.asarray(observation, np.float32)
        if value.ndim == 2 and len(value) != self._rows:
            self._rows, self._many = len(value), self._make(len(value))
        run = self._one if value.ndim == 1 else self._many
        with np.errstate(all="ignore"):  # what is not finite is for who acts on it to see
            return run(value).copy()


def save(
    path: str | os.PathLike[str],
    layers: Sequence[NetworkLayer],
    mean: Rows,
    std: Rows,
    clip: float,
    card: PolicyCard,
) -> None:
    """Write a network and what it was made for, whole or not at all. Raises InvalidInput, OSError.

    The observation becomes clip((observation - mean) / std, -clip, clip) before the first layer; what the
    last one gives is clipped to -1..1.
    """
    from onnx import helper

    counts = len(mean), len(layers[-1].bias) if layers else 0
    if counts != (card.observations, len(card.joints)):
        expected = f"{card.observations} and {len(card.joints)}"
        raise InvalidInput(
            f"the network has {counts[0]} observations and {counts[1]} actions, its card {expected}"
        )
    made = onnx_writer.build_graph(layers, mean, std, clip)
    model = helper.make_model(
        made,
        producer_name="twind",
        opset_imports=[helper.make_opsetid("", onnx_writer.OPSET)],
        ir_version=onnx_writer.IR,
    )
    helper.set_model_props(model, {KEY: card.text()})
    place = Path(path)
    beside = place.with_name(f".{place.name}.{os.getpid()}")
    try:
        beside.write_bytes(model.SerializeToString())
        beside.replace(place)
    finally:
        beside.unlink(missing_ok=True)


def load(path: str | os.PathLike[str]) -> Policy:
    """The policy of a file, checked and tried once. Raises InvalidInput naming the file."""
    try:
        return _loaded(_bytes(Path(path)))
    except InvalidInput as error:
        raise InvalidInput(f"{path}: {error}") from None


def _bytes(path: Path) -> bytes:
    try:
        # Not blocking: a FIFO of that name would wait for ever.
        with open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise InvalidInput("is no file")
            data = file.read(LARGEST + 1)
    except OSError as error:
        raise InvalidInput(error.strerror or str(error)) from None
    if len(data) > LARGEST:
        raise InvalidInput(f"has {os.path.getsize(path)} bytes, at most {LARGEST} are read")
    return data


def _loaded(data: bytes) -> Policy:
    model = parsed(data)
    texts = [value for key, value in model.metadata if key == KEY]
    if len(texts) != 1:
        raise InvalidInput(
            f"has no card ({KEY!r} in its metadata): write it with `twindctl train`, or `save`"
        )
    card = cards.read(texts[0])
    _require_same((model.observations, model.actions), card)
    steps = chain_inference.chain(model)
    policy = Policy(card, lambda rows: chain_inference.compiled(steps, rows, card.observations))
    _try(policy)
    return policy


def _require_same(counts: tuple[int, int], card: PolicyCard) -> None:
    for what, has, said in (
        (INPUT, counts[0], card.observations),
        (OUTPUT, counts[1], len(card.joints)),
    ):
        if has != said:
            raise InvalidInput(f"its {what} has {has} entries, its card says {said}")


def _try(policy: Policy) -> None:
    """Once, where nothing moves yet: what only fails when it runs must fail here."""
    try:
        action = policy.act(np.zeros(policy.card.observations, np.float32))
    except Exception as error:  # noqa: BLE001  whatever an array of anybody's can raise
        raise InvalidInput(f"it cannot be run: {' '.join(str(error).split())[:200]}") from None
    if action.shape != (len(policy.card.joints),) or action.dtype != np.float32:
        raise InvalidInput(f"its action is {action.dtype}{action.shape}, one float32 per joint is needed")
