"""Learning package: environments, training, policies, streams, data sets.

Reaches a robot through the client alone.
"""


def register() -> None:
    """Let Gymnasium know `twind/Stand-v0` and the others: then `gymnasium.make` finds them."""
    from twind.learn import envs  # noqa: F401 # an extra that a robot may lack
