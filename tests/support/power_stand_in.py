"""Stand-in for the power process in the rig under a fake clock: the dead man's decision without a process."""

from collections.abc import Callable

from twind.config.power_config import ButtonSpec, RelaySpec
from twind.power.dead_man import DeadMan
from twind.power.power_states import ButtonState, RelayState


class PowerStandIn:
    """As `PowerChild`. `switch` is called with each change of the relay, unless it is `stuck`."""

    def __init__(self, level: str = "settle", *, relay: bool = True, button: bool = True) -> None:
        self.relay_spec = RelaySpec("lcus1", "relay", -1, False, 0.1, 1.0) if relay else None
        self.button_spec = ButtonSpec("serial", "button", level, -1, -1) if button else None
        self.pid: int | None = None
        self.relay = RelayState.UNKNOWN
        self.button = ButtonState.UNKNOWN
        self.trouble = ""
        self.switch: Callable[[bool], None] = lambda on: None
        self.works = True  # the process reports
        self.closed_at: float | None = None
        self.ended = False
        self._button = ButtonState.RELEASED
        self._dead_man = DeadMan(0.1)
        self.beats = 0
        self._wanted = False
        self._closed = False

    def set_button(self, state: ButtonState) -> None:
        """Press, release or unplug the button."""
        self._button = state

    def beat(self, wanted: bool) -> None:
        self.beats += 1
        self._wanted = wanted

    def supervise(self, now: float) -> None:
        self.pid = 1
        closed = self._dead_man.is_closed(self.beats, self._wanted, now)
        if closed is not self._closed:
            self._closed = closed
            self.closed_at = now if closed else None
            self.switch(closed)
        state = RelayState.CLOSED if closed else RelayState.OPEN
        state = RelayState.TRIPPED if self._dead_man.tripped else state
        self.relay = state if self.works and self.relay_spec else RelayState.UNKNOWN
        self.button = self._button if self.works and self.button_spec else ButtonState.UNKNOWN

    def close(self) -> None:
        self.ended = True
