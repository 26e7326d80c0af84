"""Transport of frames: the interface between a CAN bus and its adapter.

One channel is one controller on one wire. It never blocks and has no thread: its user polls the descriptor,
or queries the time of the next arrival. Foreign and erroneous frames are passed on unchanged; the bus
distinguishes them.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

from twind_drivers.clock import WaitableSource
from twind_drivers.ports.frame import Frames


class CanErrorState(IntEnum):
    """State of the controller on the wire (ISO 11898-1, fault confinement)."""

    ACTIVE = 0
    PASSIVE = 1  # many errors: reported, without reaction
    OFF = 2  # the controller has left the wire, or no node acknowledges its frames


@dataclass(slots=True)
class CanChannelStatus:
    """Known state of the line. A channel without error frames (slcan) only has that of full queues."""

    line: CanErrorState = CanErrorState.ACTIVE
    refused: int = 0  # frames that the adapter did not take since the channel was opened
    errors: int = 0  # error frames, and bytes or lines that were no frame


class CanChannel(WaitableSource, Protocol):
    """Channel of frames to and from one wire."""

    name: str  # for error messages: can0, /dev/ttyACM0
    warning: str  # a fault under which the channel still works, with its remedy; empty: none
    condition: CanChannelStatus

    def send(self, frames: Frames, now: float) -> None:
        """Send all frames, in this order, in one system call where the adapter has one.

        Raises PortError. Kind OUTPUT_FULL: the queue still held earlier frames. It is purged, none is sent.
        Kind LOST: the adapter went away, or has accepted nothing for a second.
        """

    def receive(self, now: float) -> Frames:
        """All that has arrived, error frames not among them. Raises PortError of kind LOST."""

    def drive(self, owner: object) -> None:
        """Declare that motors are driven over the channel while `owner` lives.

        A link may then go down and up to be emptied. A pure reader never does that: its frames cannot move a
        motor.
        """

    def purge(self) -> None:
        """Drop what has not left yet, in every reachable queue. Raises PortError of kind LOST."""

    def close(self) -> None:
        """Purge and release the port. May be called twice; never raises."""
