"""A policy in a file: ONNX with its normalisation baked in, and a card that says what it was made for.

A file may come from an untrusted source. Its size is bounded before it is read. A model can take all memory,
go on for ever or end its process while it loads. So each file runs once in a process of its own before this
process loads it (`python -m twind.learn.policy.policy_file`), within the bounds of `onnx_session.py`.
"""

import os
import stat
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np

from twind.exceptions import InvalidInput
from twind.learn.policy import onnx_writer
from twind.learn.policy import policy_card as cards
from twind.learn.policy.onnx_session import OUTPUT, OnnxSession, Rows, limit_memory
from twind.learn.policy.onnx_writer import NetworkLayer
from twind.learn.policy.policy_card import PolicyCard
from twind.new_file import write_new

LARGEST = 8 << 20  # bytes of a file; the network of 24 joints has half a megabyte
KEY = "twind"  # of the card in `metadata_props`
CHECKED = 20.0  # s of a check, the start of an interpreter and the import of onnxruntime included
_REFUSED = 3  # exit code of a check, with the reason on stdout

__all__ = ["InvalidInput", "NetworkLayer", "Policy", "PolicyCard", "load", "read", "save", "save_model"]


class Policy:
    """Network and card of a file. Not for several threads at once."""

    def __init__(self, card: PolicyCard, session: OnnxSession) -> None:
        self.card = card
        self._session = session

    def act(self, observation: Rows) -> Rows:
        """Return the action (n,) for an observation (N,), or (batch, n) for (batch, N). A new array, float32.

        NaN where the network makes NaN. Raises ValueError for another shape, InvalidInput where the network
        fails.
        """
        count = self.card.observations
        if observation.shape[-1:] != (count,) or observation.ndim > 2:
            raise ValueError(f"observation {observation.shape}: ({count},) or (batch, {count}) is needed")
        rows = np.asarray(observation, np.float32).reshape(-1, count)
        action = self._session.run(rows)
        expected = (len(rows), len(self.card.joints))
        if action.shape != expected or action.dtype != np.float32:
            raise InvalidInput(f"its {OUTPUT} is {action.dtype} {action.shape}, float32 {expected} is needed")
        return action[0] if observation.ndim == 1 else action

    def ending_long_inferences(self) -> AbstractContextManager[None]:
        """End each inference that takes more than a second: `act` then raises InvalidInput."""
        return self._session.ending_long_inferences()


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
    model = helper.make_model(
        onnx_writer.build_graph(layers, mean, std, clip),
        producer_name="twind",
        opset_imports=[helper.make_opsetid("", onnx_writer.OPSET)],
        ir_version=onnx_writer.IR,
    )
    save_model(path, model, card)


def save_model(path: str | os.PathLike[str], model: Any, card: PolicyCard) -> None:
    """Write any `onnx.ModelProto` with its card, whole or not at all. Raises InvalidInput, OSError.

    The model maps `observation` (batch, N) to `action` (batch, n) in -1..1, both float32; `load` checks that.
    """
    from onnx import helper

    helper.set_model_props(model, {KEY: card.text()})
    place = Path(path)
    beside = place.with_name(f".{place.name}.{os.getpid()}")
    try:
        write_new(beside, model.SerializeToString())
        beside.replace(place)
    finally:
        beside.unlink(missing_ok=True)


def load(path: str | os.PathLike[str]) -> Policy:
    """Return the policy of a file, tried in a process of its own. Raises InvalidInput naming the file."""
    try:
        data = network_bytes(Path(path))
        require_runnable(__name__, data)
        return read(data)
    except InvalidInput as error:
        raise InvalidInput(f"{path}: {error}") from None


def read(data: bytes) -> Policy:
    """Return the policy of the bytes of a file, run once in this process. Raises InvalidInput."""
    return from_session(OnnxSession(data))


def from_session(session: OnnxSession) -> Policy:
    """Return the policy of a loaded model, run once. Raises InvalidInput."""
    text = session.metadata.get(KEY)
    if text is None:
        remedy = "write it with `twindctl train`, `save` or `save_model`"
        raise InvalidInput(f"has no card ({KEY!r} in its metadata): {remedy}")
    card = cards.read(text)
    session.require_shapes(card.observations, len(card.joints))
    policy = Policy(card, session)
    action = policy.act(np.zeros(card.observations, np.float32))
    if not np.isfinite(action).all():
        joint = int(np.argmin(np.isfinite(action)))
        raise InvalidInput(
            f"its action of {card.joints[joint]} is {action[joint]} for an observation of zeros, "
            "finite numbers are needed: check its weights"
        )
    return policy


def network_bytes(path: Path) -> bytes:
    """Return the bytes of a file of at most `LARGEST`. Raises InvalidInput."""
    try:
        # Not blocking: a FIFO of that name would wait for ever.
        with open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise InvalidInput("is no regular file")
            data = file.read(LARGEST + 1)
    except OSError as error:
        raise InvalidInput(error.strerror or str(error)) from None
    if len(data) > LARGEST:
        raise InvalidInput(f"has {os.path.getsize(path)} bytes, at most {LARGEST} are read")
    return data


def require_runnable(module: str, data: bytes) -> None:
    """Run a `module` that calls `check_stdin` on `data`, in a process of its own. Raises InvalidInput."""
    command = [sys.executable, "-m", module]
    try:
        done = subprocess.run(command, input=data, capture_output=True, timeout=CHECKED, check=False)
    except subprocess.TimeoutExpired:
        raise InvalidInput(f"its first inference was not done within {CHECKED:g} s") from None
    if done.returncode == _REFUSED:
        raise InvalidInput(done.stdout.decode(errors="replace"))
    if done.returncode:
        reason = done.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        raise InvalidInput(f"its check ended with exit code {done.returncode}: {reason[:200]}")


def check_stdin(check: Callable[[bytes], object]) -> int:
    """Check the bytes on stdin within limited memory; 0: they can be run."""
    import onnxruntime  # noqa: F401  what it takes by itself is no part of the limit

    data = sys.stdin.buffer.read()
    limit_memory()
    try:
        check(data)
    except InvalidInput as error:
        sys.stdout.buffer.write(str(error).encode(errors="replace"))
        return _REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(check_stdin(read))
