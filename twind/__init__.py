"""twind: owns a robot's buses, keeps a MuJoCo twin in step, lets nothing unchecked reach a servo."""

from twind.version import __version__

__all__ = ["__version__"]
