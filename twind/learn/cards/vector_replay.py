"""Test vectors of a card: what the network must give for stored observations, step after step."""

import io
import zipfile
import zlib
from math import prod
from pathlib import Path

import numpy as np

from twind.exceptions import InvalidInput
from twind.learn.cards.card_actor import CardPolicy
from twind.learn.cards.interface_card import VectorSpec
from twind.learn.policy.onnx_session import Rows
from twind.plain_file import read_plain

LARGEST = 8 << 20  # bytes of a file, and of its arrays together
MOST_STEPS = 10_000
# What NumPy and zipfile raise for files that are damaged, encrypted, packed by other methods or no numbers.
UNREADABLE = (
    *(OSError, ValueError, TypeError, KeyError, EOFError, MemoryError, RuntimeError, NotImplementedError),
    *(zipfile.BadZipFile, zlib.error),
)


def replay_vectors(policy: CardPolicy, spec: VectorSpec, folder: Path) -> tuple[int, float]:
    """Return the number of steps and the largest difference of an action.

    The recurrent state is zero before the first step and goes on from step to step. Raises InvalidInput.
    """
    arrays = _arrays(spec, folder)
    shapes = {**policy.shapes, policy.card.action.output: (1, len(policy.card.joints))}
    missing = [name for name in shapes if name not in arrays]
    if missing:
        raise InvalidInput(f"{spec.file}: has no array {', '.join(missing)}: one per input, and the action")
    steps = arrays[policy.card.action.output].shape[:1] or (0,)
    for name, shape in shapes.items():
        fits = arrays[name].shape[:1] == steps and arrays[name].size == steps[0] * prod(shape)
        if not fits or not 0 < steps[0] <= MOST_STEPS:
            found = f"{name} is {arrays[name].shape}"
            wanted = f"(steps, {', '.join(map(str, shape[1:]))}) of the same 1 to {MOST_STEPS} steps"
            raise InvalidInput(f"{spec.file}: {found}, {wanted} is needed")
    policy.begin()
    worst = 0.0
    for step in range(steps[0]):
        seen = {
            name: arrays[name][step].reshape(shape).astype(np.float32)
            for name, shape in policy.shapes.items()
        }
        away = np.abs(policy.act(seen) - arrays[policy.card.action.output][step].reshape(-1))
        worst = max(worst, float(away.max()) if np.isfinite(away).all() else np.inf)
    policy.begin()
    return steps[0], worst


def _arrays(spec: VectorSpec, folder: Path) -> dict[str, Rows]:
    """Arrays of the file, which lies in `folder`. Raises InvalidInput."""
    place = folder / spec.file
    if not place.resolve().is_relative_to(folder.resolve()):
        raise InvalidInput(f"{spec.file}: test vectors lie in the folder of the card, {folder}")
    try:
        data = read_plain(place, LARGEST)
        with zipfile.ZipFile(io.BytesIO(data)) as packed:
            if sum(each.file_size for each in packed.infolist()) > LARGEST:
                raise InvalidInput(f"{spec.file}: unpacks to more than {LARGEST >> 20} MiB")
        with np.load(io.BytesIO(data), allow_pickle=False) as stored:
            return {name: np.asarray(stored[name], np.float64) for name in stored.files}
    except UNREADABLE as error:
        raise InvalidInput(f"{spec.file}: cannot be read as an .npz file of numbers: {error}") from None
