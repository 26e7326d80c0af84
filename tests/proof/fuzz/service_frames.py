"""Bytes to the sockets of a service, by a local user who may open one of them.

    python -m tests.proof.fuzz.service_frames FOLDER NAME COUNT SEED

`NAME` is control or observe. It runs as that user, and knows of the service only what its sockets answer; who
started it looks after processes, memory and journal, and causes the news that some calls wait for.
"""

import sys
from pathlib import Path
from random import Random

from tests.proof.fuzz.frames import Frames


class ServiceTarget:
    """One socket of a service that somebody else started."""

    def __init__(self, folder: Path, name: str) -> None:
        self.folder = folder
        self.attacked: tuple[str, ...] = (name,)

    def cause_news(self) -> None:
        """Left to who started this."""

    def forget(self) -> None:
        """Nothing is kept here."""

    def require_running(self) -> None:
        """Seen by its answers alone."""

    def resident(self) -> int | None:
        """Memory of another user's process, which is not ours to judge."""
        return None

    def close(self) -> None:
        """Nothing was started here."""


def main(folder: str, name: str, count: str, seed: str) -> None:
    """Frames until there were `count`. Raises AssertionError with the number of the input."""
    frames = Frames(ServiceTarget(Path(folder), name))
    number = 0
    while frames.frames < int(count):
        try:
            frames.one(Random(f"frames {seed} {number}"))
        except Exception as error:
            raise AssertionError(f"input {number} of seed {seed}") from error
        number += 1
    summary = frames.finish()
    print(f"{name}: {frames.frames} frames of seed {seed}: {summary}")


if __name__ == "__main__":
    main(*sys.argv[1:])
