"""Request of a robot's description from its daemon, again until it succeeds. Library, 3.10."""

from __future__ import annotations

import threading
from collections.abc import Callable

from twind.bridge.ros.robot_model_messages import RobotModelMessages
from twind.client import Client

AGAIN = 5.0  # s between two requests


class DescriptionRequest:
    """Asks one daemon after the other; runs in threads of its own."""

    def __init__(
        self,
        observer: Callable[[], Client],
        describe: Callable[[object], RobotModelMessages],
        publish: Callable[[RobotModelMessages | None], None],
        lives: Callable[[], int],
        tell: Callable[[str], None],
        stop: threading.Event,
    ) -> None:
        """`describe`: of an answer of GetRobot; `lives`: daemons found so far, which end older requests."""
        self._observer = observer
        self._describe = describe
        self._publish = publish
        self._lives = lives
        self._tell = tell
        self._stop = stop
        # Of one daemon at a time: a thread of an older one publishes nothing once a newer one has begun.
        self._publishing = threading.Lock()

    def start(self, life: int) -> None:
        """Ask daemon number `life` in a thread."""
        threading.Thread(target=self.run, args=(life,), name="describe", daemon=True).start()

    def run(self, life: int) -> None:
        """Ask until it succeeds; until then there is no description, for another robot's would be wrong."""
        self._publish_for(life, None)
        told = ""
        while self._lives() == life and not self._stop.is_set():
            try:
                with self._observer() as client:
                    found = self._describe(client.call("GetRobot"))
            except Exception as error:  # noqa: BLE001  a thread that dies in silence would leave no description
                if str(error) != told:
                    told = str(error)
                    self._tell(f"no /robot_description and no /tf: {error}; next try in {AGAIN:g} s")
                if self._stop.wait(AGAIN):
                    return
                continue
            self._publish_for(life, found)
            return

    def _publish_for(self, life: int, found: RobotModelMessages | None) -> None:
        """Publish for daemon number `life`, unless a newer one was found: its own thread withdraws this."""
        with self._publishing:
            if self._lives() == life:
                self._publish(found)
