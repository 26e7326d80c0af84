"""E-stop and stop: each has a thread and connections of its own, and waits for nothing else in the viewer.

A press is taken in the web server's loop, which draws nothing. Connections are made anew for each call, as
the daemon may have restarted, and it keeps places for whoever wants to stop.
"""

import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass

from twind.client import Client, ClientError, NoDaemon

BOUND = 5.0  # s until a call counts as not answered
HARDWARE = "if the robot still moves, use its own switch"

Tell = Callable[["Outcome"], None]


@dataclass(frozen=True, slots=True)
class Outcome:
    """What the daemon answered to one press."""

    done: bool
    title: str
    text: str


class Errand(threading.Thread):
    """Does one thing again and again, whenever asked; never two at once."""

    def __init__(self, name: str, do: Callable[[], Outcome]) -> None:
        super().__init__(name=name, daemon=True)
        self._do = do
        self._asked: queue.SimpleQueue[Tell] = queue.SimpleQueue()
        self.start()

    def ask(self, tell: Tell) -> None:
        """Returns at once; `tell` has the outcome later, in this thread."""
        self._asked.put(tell)

    def run(self) -> None:
        """Who asked while it was being done has the outcome of the next time, once for all of them."""
        while True:
            tellers = [self._asked.get()]
            while not self._asked.empty():
                tellers.append(self._asked.get())
            outcome = self._do()
            for tell in tellers:
                tell(outcome)


class Stops:
    """The two errands of one daemon. `place`: folder of its sockets."""

    def __init__(self, place: str | None, bound: float = BOUND) -> None:
        self._place, self._bound = place, bound
        self.estop = Errand("e-stop", self._estop)
        self.stop = Errand("stop", self._stop)

    def _estop(self) -> Outcome:
        """By whichever socket lets us in: both take it."""
        failure = ""
        for name in ("observe", "control"):
            client = Client(self._place, name=name, timeout=self._bound)
            try:
                answer = client.call("EStop", level="settle", reason="twindctl view")
            except NoDaemon as error:
                failure = str(error)
                continue
            except ClientError as error:
                failure = str(error)
                break
            finally:
                client.close()
            off = {True: "torque is off", False: "torque is on", None: "torque unknown"}
            return Outcome(True, "e-stop", f"state {answer['state']}, {off[answer.get('torque_off')]}")
        return Outcome(False, "e-stop NOT confirmed", f"{failure}; {HARDWARE}")

    def _stop(self) -> Outcome:
        """Cancel: for operators."""
        client = Client(self._place, timeout=self._bound)
        try:
            answer = client.call("Cancel")
        except ClientError as error:
            return Outcome(False, "NOT stopped", f"{error}; the e-stop needs no operator")
        finally:
            client.close()
        return Outcome(True, "stopping", f"the motion comes to a hold; state {answer['state']}")
