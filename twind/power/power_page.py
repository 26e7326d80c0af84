"""Page of memory that the loop and the power process share: heartbeats, wishes and states, a byte each.

A store of a byte is no system call: a tick pays less than a microsecond for its heartbeat.
"""

import mmap

from twind.power.power_states import ButtonState, RelayState

SIZE = 4096
# Written by the loop
_LOOP_BEAT = 0
_WANTED = 1
# Written by the process
_PROCESS_BEAT = 64
_RELAY = 65
_BUTTON = 66
_LENGTH = 67
_TEXT = 68
_LONGEST = 180  # bytes of text


class PowerPage:
    """The page behind a descriptor of at least `SIZE` bytes."""

    def __init__(self, fd: int) -> None:
        self._bytes = mmap.mmap(fd, SIZE)

    def close(self) -> None:
        """Release the page."""
        self._bytes.close()

    # ------------------------------------------------------------------------------- the loop writes

    def beat(self, wanted: bool) -> None:
        """Note a completed tick, and whether the relay is to be closed."""
        self._bytes[_WANTED] = wanted
        self._bytes[_LOOP_BEAT] = (self._bytes[_LOOP_BEAT] + 1) & 255

    @property
    def loop_beat(self) -> int:
        """Count of beats of the loop, modulo 256."""
        return self._bytes[_LOOP_BEAT]

    @property
    def wanted(self) -> bool:
        """True if the loop asks for a closed relay."""
        return self._bytes[_WANTED] == 1

    # ------------------------------------------------------------------------------- the process writes

    def report(self, relay: RelayState, button: ButtonState, trouble: str) -> None:
        """Note both states and a text for people about what does not work."""
        text = trouble.encode()[:_LONGEST]
        self._bytes[_TEXT : _TEXT + len(text)] = text
        self._bytes[_LENGTH] = len(text)
        self._bytes[_RELAY] = relay
        self._bytes[_BUTTON] = button
        self._bytes[_PROCESS_BEAT] = (self._bytes[_PROCESS_BEAT] + 1) & 255

    def clear(self) -> None:
        """Forget the states of a process that is gone."""
        self.report(RelayState.UNKNOWN, ButtonState.UNKNOWN, "")

    @property
    def process_beat(self) -> int:
        """Count of beats of the process, modulo 256."""
        return self._bytes[_PROCESS_BEAT]

    @property
    def relay(self) -> RelayState:
        """State of the relay as last reported."""
        return RelayState(self._bytes[_RELAY])

    @property
    def button(self) -> ButtonState:
        """State of the button as last reported."""
        return ButtonState(self._bytes[_BUTTON])

    @property
    def trouble(self) -> str:
        """Text for people about what does not work; empty: nothing."""
        return self._bytes[_TEXT : _TEXT + self._bytes[_LENGTH]].decode(errors="replace")
