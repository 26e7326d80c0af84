"""Where questions from afar come in: what is none is refused at once, and every question gets an answer."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import zenoh

from twind.bridge.uplink.remote_contract import SMALL, UPLINK, busy, check_query, check_size, no_daemon
from twind.bridge.zenoh.zenoh_keys import robot_key
from twind.client import CallError, ClientError

JSON = zenoh.Encoding.APPLICATION_JSON
Tell = Callable[[str], None]
Serve = Callable[[dict[str, Any]], dict[str, Any]]  # what is asked -> answer; raises ClientError
Outcome = dict[str, Any] | CallError


class RemoteQuery:
    """One that came to `where`. `asked`: its parameters; empty until `answer` where it is large."""

    def __init__(self, method: str, where: str, query: zenoh.Query, tell: Tell) -> None:
        self._method = method
        self._where = where
        self._query = query
        self._tell = tell
        self._size = 0 if query.payload is None else len(query.payload)
        self.asked: dict[str, Any] = {}

    def look(self) -> None:
        """Read it, if that is soon done. Raises CallError: it is none, or too large to be copied at all."""
        check_size(self._method, self._size)
        if self._size <= SMALL:
            self._read()

    def answer(self, serve: Serve) -> None:
        """Have it answered, here and now, and let it go."""
        self.reply(self.outcome(serve))

    def outcome(self, serve: Serve) -> Outcome:
        """What `serve` makes of it."""
        try:
            if self._size > SMALL:
                self._read()
            return serve(self.asked)
        except CallError as error:
            return error
        except ClientError as error:
            return no_daemon(error)
        except Exception as error:  # noqa: BLE001  one question must not cost the others their lane
            said = f"{type(error).__name__}: {error}"
            self._tell(f"{self._where}: {said}")
            return CallError(f"{UPLINK}.Failed", {"message": said})

    def reply(self, outcome: Outcome) -> None:
        """Send it, and let the question go."""
        try:
            with self._query as query:  # whoever asked knows that all is said when the question is let go
                if isinstance(outcome, CallError):
                    said = {"error": outcome.error, "parameters": dict(outcome.parameters)}
                    query.reply_err(encoded(said), encoding=JSON)
                else:
                    query.reply(self._where, encoded(outcome), encoding=JSON, express=True)
        except Exception as error:  # noqa: BLE001  whoever asked is gone, or asked for another key
            self._tell(f"{self._where}: not answered: {error}")

    def forget(self) -> None:
        """Let it go without an answer: whoever asked is told so, and may ask again."""
        with self._query:
            pass

    def _read(self) -> None:
        payload = self._query.payload
        self.asked = check_query(self._method, b"" if payload is None else payload.to_bytes())


Take = Callable[[RemoteQuery], bool]  # in a thread of the engine; False: there is no room for it


class QueryServer:
    """Opens keys of one robot."""

    def __init__(self, session: zenoh.Session, robot: str, tell: Tell) -> None:
        self._session = session
        self._robot = robot
        self._tell = tell
        self._open: list[Any] = []

    def open(self, method: str, take: Take, *key: str) -> None:
        """Let in what is a question of `method` at `twind/ROBOT/KEY`."""
        where = robot_key(self._robot, *key)

        def came(query: zenoh.Query) -> None:
            one = RemoteQuery(method, where, query, self._tell)
            try:
                one.look()
            except CallError as error:
                one.reply(error)
                return
            if not take(one):
                one.reply(busy(f"{'/'.join(key)}: too many questions wait; ask again later"))

        self._open.append(
            self._session.declare_queryable(where, zenoh.handlers.Callback(came, indirect=False))
        )

    def close(self) -> None:
        """Take no more questions."""
        while self._open:
            self._open.pop().undeclare()


def encoded(answer: dict[str, Any]) -> bytes:
    """As JSON."""
    return json.dumps(answer, ensure_ascii=False, separators=(",", ":")).encode()
