"""`make pictures`: those of docs/learn.md: the curve of a training, and what it is good for.

Writes docs/pictures/curve.png and stand.png. Takes a minute of one core: the training is that of the tests.
"""

import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from PIL import Image

from tests.support.make_pictures import FOLDER, MOST, smaller
from tests.support.trained_policy import settings, train
from twind.learn.policy.policy_file import load

EVERY = 4096  # steps from one point of the curve to the next
MOMENTS = (0, 50, 100, 150)  # control steps, of 20 ms
MIDDLE = slice(80, 400), slice(190, 450)  # rows and columns of a picture that the robot is in
TRIES = 100  # episodes that may begin until one is found in which the zero policy falls in that time


def main() -> int:
    """Both; 1 where one is too large."""
    with tempfile.TemporaryDirectory(prefix="twind-pictures-") as made:
        file = train(Path(made) / "stand", replace(settings(), evaluate_every=EVERY))
        shutil.copy(file.parent / "curve.png", FOLDER / "curve.png")
        side_by_side(file, FOLDER / "stand.png")
    smaller(FOLDER / "curve.png")
    sizes = {name: (FOLDER / name).stat().st_size for name in ("stand.png", "curve.png")}
    for name, size in sizes.items():
        print(f"{name}: {size} bytes")
    return int(max(sizes.values()) > MOST)


def side_by_side(file: Path, out: Path) -> None:
    """The zero policy above, the trained one below: the same moments of the same episode."""
    trained = load(file)
    env = gymnasium.make("twind.learn.envs:twind/Stand-v0", render_mode="rgb_array")
    for seed in range(TRIES):
        zero, fell = seen(env, seed, lambda observation: np.zeros(env.action_space.shape, np.float32))
        if fell:
            break
    rows = (zero, seen(env, seed, trained.act)[0])
    env.close()
    Image.fromarray(np.vstack([np.hstack(row) for row in rows])).save(out, optimize=True)


def seen(env: Any, seed: int, act: Callable[[Any], Any]) -> tuple[list[Any], bool]:
    """Pictures of the robot at each moment, lying where it fell; and whether it fell."""
    observation, _ = env.reset(seed=seed)
    pictures = []
    fallen = False
    for step in range(max(MOMENTS) + 1):
        if step in MOMENTS:
            pictures.append(env.render()[MIDDLE])
        if not fallen:
            observation, _, fallen, _, _ = env.step(act(observation))
    return pictures, fallen


if __name__ == "__main__":
    sys.exit(main())
