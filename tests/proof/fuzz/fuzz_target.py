"""A program that is given inputs of one kind."""

from random import Random


class FuzzTarget:
    """Base of all kinds; one that has nothing to sum up or to remove has `one` alone."""

    def one(self, rng: Random) -> int | None:
        """Give one input, or as many as it returns. Raises whatever is wrong."""
        raise NotImplementedError

    def finish(self) -> str:
        """Summary of the run. Raises where the target did not live through it."""
        return ""

    def close(self) -> None:
        """Remove what it left."""
