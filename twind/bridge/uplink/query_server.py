"""Server of remote queries: invalid ones are refused at once, and every query gets an answer."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

import zenoh

from twind.bridge.commands.stop_queues import Outcome, Tell
from twind.bridge.uplink.remote_contract import SMALL, UPLINK, as_call_error, busy, check_query, check_size
from twind.bridge.zenoh.zenoh_keys import robot_key
from twind.client import CallError, ClientError

JSON = zenoh.Encoding.APPLICATION_JSON
Serve = Callable[[dict[str, Any]], Mapping[str, Any]]  # parameters -> answer; raises ClientError


class RemoteQuery:
    """Query received at key `where`. `parameters`: empty until `answer` for a large query."""

    def __init__(self, method: str, where: str, query: zenoh.Query, tell: Tell) -> None:
        self._method = method
        self._where = where
        self._query = query
        self._tell = tell
        self._size = 0 if query.payload is None else len(query.payload)
        self.parameters: dict[str, Any] = {}

    def look(self) -> None:
        """Read the query if that is quick. Raises CallError: invalid, or too large to be copied."""
        check_size(self._method, self._size)
        if self._size <= SMALL:
            self._read()

    def answer(self, serve: Serve) -> None:
        """Answer the query here and now, and release it."""
        self.reply(self._outcome(serve))

    def _outcome(self, serve: Serve) -> Outcome:
        """Return the result of `serve`, or its error, which no variable keeps: its frames have the data."""
        try:
            if self._size > SMALL:
                self._read()
            return serve(self.parameters)
        except ClientError as error:
            return error
        except Exception as error:  # noqa: BLE001  one query must not end the queue of the others
            message = f"{type(error).__name__}: {error}"
            self._tell(f"{self._where}: {message}")
            return CallError(f"{UPLINK}.Failed", {"message": message})

    def reply(self, outcome: Outcome) -> None:
        """Send the answer, and release the query."""
        try:
            with self._query as query:  # releasing the query reports the end of the answer to its sender
                if isinstance(outcome, ClientError):
                    error = as_call_error(outcome)
                    message = {"error": error.error, "parameters": dict(error.parameters)}
                    query.reply_err(encoded(message), encoding=JSON)
                else:
                    query.reply(self._where, encoded(outcome), encoding=JSON, express=True)
        except Exception as error:  # noqa: BLE001  the sender is gone, or the key is another one
            self._tell(f"{self._where}: not answered: {error}")

    def forget(self) -> None:
        """Drop the query without an answer: its sender is notified, and may repeat it."""
        with self._query:
            pass

    def _read(self) -> None:
        payload = self._query.payload
        self.parameters = check_query(self._method, b"" if payload is None else payload.to_bytes())


Take = Callable[[RemoteQuery], bool]  # in a thread of the engine; False: there is no room for it


class QueryServer:
    """Server of the query keys of one robot."""

    def __init__(self, session: zenoh.Session, robot: str, tell: Tell) -> None:
        self._session = session
        self._robot = robot
        self._tell = tell
        self._open: list[Any] = []

    def open(self, method: str, take: Take, *key: str) -> None:
        """Accept queries of `method` at `twind/ROBOT/KEY`."""
        where = robot_key(self._robot, *key)

        def came(query: zenoh.Query) -> None:
            one = RemoteQuery(method, where, query, self._tell)
            try:
                one.look()
            except CallError as error:
                one.reply(error)
                return
            if not take(one):
                one.reply(busy(f"{'/'.join(key)}: too many queries wait; retry later"))

        callback = zenoh.handlers.Callback(came, indirect=False)
        self._open.append(self._session.declare_queryable(where, callback))

    def close(self) -> None:
        """Accept no more queries."""
        while self._open:
            self._open.pop().undeclare()


def encoded(answer: Mapping[str, Any]) -> bytes:
    """Encode an answer as JSON."""
    return json.dumps(answer, ensure_ascii=False, separators=(",", ":")).encode()
