"""Buttons that stop robots, and the notification of a tab about the result."""

from collections.abc import Callable, Coroutine
from typing import Any

from twind.observe.viewing.stop_threads import StopAction, StopOutcome

# s that a notification of a failure is seen, and of what was done
STAYS = 60.0
LASTS = 6.0
Press = Callable[[Any], Coroutine[Any, Any, None]]


def stop_window(gui: Any, estop: StopAction, stop: StopAction, whom: str = "") -> None:
    """A window of its own above everything: it scrolls away with nothing and cannot be closed."""
    panel = gui.add_panel(order=-1.0)
    with panel.add_tab("stop"):
        stop_buttons(gui, estop, stop, whom)
    panel.float(x=12, y=-12, width=230)  # from the lower left: notifications come down from above


def stop_buttons(gui: Any, estop: StopAction, stop: StopAction, whom: str = "", of: str = "") -> None:
    """Add both buttons to the open container. `whom`: their label; `of`: prefix of the notification."""
    what = f" {whom}" if whom else ""
    first = gui.add_button(f"E-STOP{what}", color="red", hint="lower the robot, torque off, latched")
    second = gui.add_button(
        f"Stop{what}", color="orange", hint="the motion comes to a hold; needs an operator"
    )
    first.on_click(_pressed(estop, of))
    second.on_click(_pressed(stop, of))


def _pressed(action: StopAction, of: str) -> Press:
    async def press(event: Any) -> None:  # in the server's loop: behind no drawing, and in no queue of ours
        action.ask(teller(event.client, of))

    return press


def teller(client: Any, of: str = "") -> Callable[[StopOutcome], None]:
    """A function that shows a result in one tab."""

    def show_outcome(outcome: StopOutcome) -> None:
        if client is not None:
            client.add_notification(
                f"{of}: {outcome.title}" if of else outcome.title,
                outcome.text,
                color="green" if outcome.done else "red",
                auto_close_seconds=LASTS if outcome.done else STAYS,
            )

    return show_outcome
