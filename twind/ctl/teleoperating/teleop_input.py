"""Interface of a device for teleoperation: controls that are held, and those that were pressed."""

from collections.abc import Mapping, Sequence
from typing import Protocol


class TeleopInput(Protocol):
    """A keyboard or a gamepad. Controls are named as in a mapping file. `now`: s, monotonic."""

    def take(self, now: float) -> None:
        """Read what has come, without waiting. Raises EOFError: the device is gone."""

    def held(self, now: float) -> Mapping[str, float]:
        """Return the controls that are held with the dead-man and how far: 0 to 1, axes from -1."""

    def pressed(self) -> Sequence[str]:
        """Return the controls that were pressed since the last call, with the dead-man or without."""

    def is_kept(self, control: str) -> bool:
        """Return True if a held control is not only tapped."""

    def close(self) -> None:
        """Give the device back as it was."""
