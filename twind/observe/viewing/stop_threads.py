"""E-stop and stop: buttons, and for each a thread and connections of its own that wait for nothing else.

The web server's loop, which draws nothing, takes a press. Connections are made anew for each call, since
the daemon may have restarted, and it keeps places for clients that stop.
"""

import queue
import threading
import traceback
from collections.abc import Callable, Coroutine
from contextlib import closing
from dataclasses import dataclass
from typing import Any, Protocol

from twind.client import ClientError
from twind.observe.viewing.robot_connections import RobotConnections, Way

BOUND = 5.0  # s until a call counts as not answered
HARDWARE = "if the robot still moves, use its own switch"

Tell = Callable[["StopOutcome"], None]


@dataclass(frozen=True, slots=True)
class StopOutcome:
    """Answer of the daemon to one press."""

    done: bool
    title: str
    text: str


class StopAction(Protocol):
    """Action of a button."""

    def ask(self, tell: Tell) -> None:
        """Request the action and return at once. `tell` gets the outcome later, in another thread; of several
        requests, each."""


class StopThread(threading.Thread):
    """Thread that runs one action again and again, on request; never two at once."""

    def __init__(self, name: str, do: Callable[[], StopOutcome]) -> None:
        super().__init__(name=name, daemon=True)
        self._do = do
        self._asked: queue.SimpleQueue[Tell] = queue.SimpleQueue()
        self._first = threading.Lock()

    def ask(self, tell: Tell) -> None:
        """Queue a request and return at once. `tell` gets the outcome later, in this thread; the first
        request starts it."""
        self._asked.put(tell)
        with self._first:
            if self.ident is None:
                self.start()

    def run(self) -> None:
        """Run the action for each batch of requests.

        Requests that arrive while it runs all get the outcome of the next run, which is done once for all of
        them.
        """
        while True:
            tellers = [self._asked.get()]
            while not self._asked.empty():
                tellers.append(self._asked.get())
            outcome = self._outcome()
            for tell in tellers:
                try:
                    tell(outcome)
                except Exception:  # noqa: BLE001  a tab that cannot be notified must not stop the thread
                    traceback.print_exc()

    def _outcome(self) -> StopOutcome:
        """Whatever happens: a thread that ended would leave a button that does nothing."""
        try:
            return self._do()
        except Exception as error:  # noqa: BLE001
            traceback.print_exc()
            why = f"{type(error).__name__}: {error}"
            return StopOutcome(False, f"{self.name} NOT confirmed", f"{why}; {HARDWARE}")


class StopThreads:
    """The two actions of one robot. `by`: the reason that the daemon receives."""

    def __init__(self, ways: RobotConnections, bound: float = BOUND, by: str = "twindctl view") -> None:
        self._ways = ways
        self._bound = bound
        self._by = by
        self.estop = StopThread("e-stop", self._estop)
        self.stop = StopThread("stop", self._stop)

    def _estop(self) -> StopOutcome:
        """By whichever way lets us in and answers: all take it."""
        failures: list[str] = []
        for way in self._ways.reading:
            try:
                return self._estop_by(way)
            except Exception as error:  # noqa: BLE001  whatever is wrong with one, the other is tried
                said = str(error) if isinstance(error, ClientError) else f"{type(error).__name__}: {error}"
                failures.append(said)
        return StopOutcome(False, "e-stop NOT confirmed", f"{'; '.join(failures)}; {HARDWARE}")

    def _estop_by(self, way: Way) -> StopOutcome:
        with closing(way(self._bound)) as client:
            answer = client.call("EStop", level="settle", reason=self._by)
        off = {True: "torque is off", False: "torque is on", None: "torque unknown"}
        return StopOutcome(True, "e-stop", f"state {answer['state']}, {off[answer.get('torque_off')]}")

    def _stop(self) -> StopOutcome:
        """Cancel: for operators."""
        try:
            with closing(self._ways.commanding(self._bound)) as client:
                answer = client.call("Cancel")
        except ClientError as error:
            return StopOutcome(False, "NOT stopped", f"{error}; the e-stop needs no operator")
        return StopOutcome(True, "stopping", f"the motion comes to a hold; state {answer['state']}")


# s that a notification of a failure is seen, and of what was done
STAYS = 60.0
LASTS = 6.0
ButtonPress = Callable[[Any], Coroutine[Any, Any, None]]


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


def _pressed(action: StopAction, of: str) -> ButtonPress:
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
