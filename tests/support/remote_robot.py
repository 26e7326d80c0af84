"""The robot's end of the key space on a real Zenoh peer of loopback, with faults that a test orders.

It has no robot: what it answers is what the test says (`answers`), an error where that raises a CallError,
nothing where it says None.
"""

import json
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any

import zenoh

from tests.support.zenoh_router import free_port
from twind.bridge.fleet.client_sessions import PrivateSession
from twind.bridge.fleet.remote_client import client
from twind.bridge.zenoh.zenoh_keys import robot_key
from twind.bridge.zenoh.zenoh_session import NetworkConfig, open_now
from twind.client import CallError, Client

Answer = Callable[[dict[str, Any]], dict[str, Any] | None]
PARTS = ("ask/*", "check", "stop/*", "lease", "goal")
CLOCK = 500.0  # s, the robot's clock is ahead of ours


class FarRobot:
    """From its making to `close`. `asked`: when, which part, with what."""

    def __init__(self, name: str = "r1") -> None:
        # s before each answer
        self.name = name
        self.slow = 0.0
        self.asked: list[tuple[float, str, dict[str, Any]]] = []
        self.answers: dict[str, Answer] = {"lease": self.grant}
        self.place = NetworkConfig(connect=(f"tcp/127.0.0.1:{free_port()}",))
        self.session = open_now(NetworkConfig(listen=self.place.connect), 5.0)
        for part in PARTS:
            self.session.declare_queryable(robot_key(name, part), self._queried)
        self.alive = self.session.liveliness().declare_token(robot_key(name, "alive"))

    def client(self, timeout: float = 20.0) -> Client:
        """Client of this robot, by a session of its own."""
        return client(self.name, PrivateSession(self.place), timeout)

    def tell(self, part: str, report: Any) -> None:
        """News, or what became of a goal."""
        data = report if isinstance(report, bytes) else json.dumps(report).encode()
        self.session.put(robot_key(self.name, part), data)

    def grant(self, asked: dict[str, Any]) -> dict[str, Any]:
        """A lease for whoever asks."""
        now = time.monotonic() + CLOCK
        return {"lease": "L1", "holder": asked.get("holder", "?"), "expires_in": 1.0, "now": now}

    def times(self, part: str) -> list[dict[str, Any]]:
        """Questions to a part."""
        return [what for _, which, what in list(self.asked) if which == part]

    def _queried(self, query: zenoh.Query) -> None:
        threading.Thread(target=self._answer, args=(query,), daemon=True).start()

    def _answer(self, query: zenoh.Query) -> None:
        part = str(query.key_expr).split("/", 2)[2]
        what = json.loads(bytes(query.payload)) if query.payload is not None else {}
        self.asked.append((time.monotonic(), part, what))
        time.sleep(self.slow)
        try:
            told = self.answers[part](what)
        except CallError as error:
            query.reply_err(json.dumps({"error": error.error, "parameters": error.parameters}))
        else:
            if told is not None:
                query.reply(robot_key(self.name, part), json.dumps(told))
        query.drop()

    def close(self) -> None:
        """Gone. May be called twice."""
        self.session.close()

    def __enter__(self) -> "FarRobot":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
