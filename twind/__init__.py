"""twind: owns a robot's buses, keeps a MuJoCo twin in step, lets nothing unchecked reach a servo."""

from typing import TYPE_CHECKING, Any

from twind.version import __version__

if TYPE_CHECKING:
    from twind.robot_client.robot import Robot

__all__ = ["Robot", "__version__"]


def __getattr__(name: str) -> Any:
    """Import `Robot` when it is first used: the daemon and its verbs do without it."""
    if name == "Robot":
        from twind.robot_client.robot import Robot

        return Robot
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
