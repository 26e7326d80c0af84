"""Where questions from afar come in: each key has its lane, and every question gets an answer."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import zenoh

from twind.bridge.uplink.contract import UPLINK, busy, no_daemon
from twind.bridge.uplink.lanes import Lane
from twind.bridge.zenoh.keys import robot_key
from twind.client import CallError, ClientError

Serve = Callable[[bytes], dict[str, Any]]  # payload -> answer; raises ClientError
Choice = Callable[[bytes], Lane]


class Door:
    """Opens keys of one robot."""

    def __init__(self, session: zenoh.Session, robot: str, tell: Callable[[str], None]) -> None:
        self._session, self._robot, self._tell = session, robot, tell
        self._open: list[Any] = []

    def open(self, lane: Lane | Choice, serve: Serve, *key: str) -> None:
        """Serve `twind/ROBOT/KEY` in `lane`, or in the one that it chooses by the payload."""
        where = robot_key(self._robot, *key)

        def came(query: zenoh.Query) -> None:
            data = b"" if query.payload is None else query.payload.to_bytes()
            chosen = lane if isinstance(lane, Lane) else lane(data)
            if not chosen.put(lambda: self._answer(query, where, serve, data)):
                self._refuse(query, busy(f"{chosen.name}: too many questions wait; ask again later"))

        self._open.append(
            self._session.declare_queryable(where, zenoh.handlers.Callback(came, indirect=False))
        )

    def close(self) -> None:
        """Take no more questions."""
        while self._open:
            self._open.pop().undeclare()

    def _answer(self, query: zenoh.Query, where: str, serve: Serve, data: bytes) -> None:
        try:
            answer = serve(data)
        except CallError as error:
            self._refuse(query, error)
        except ClientError as error:
            self._refuse(query, no_daemon(error))
        except Exception as error:  # noqa: BLE001  one question must not cost the others their lane
            self._tell(f"{where}: {type(error).__name__}: {error}")
            self._refuse(
                query, CallError(f"{UPLINK}.Failed", {"message": f"{type(error).__name__}: {error}"})
            )
        else:
            self._send(query, lambda: query.reply(where, encoded(answer), encoding=JSON, express=True))

    def _refuse(self, query: zenoh.Query, error: CallError) -> None:
        said = encoded({"error": error.error, "parameters": dict(error.parameters)})
        self._send(query, lambda: query.reply_err(said, encoding=JSON))

    def _send(self, query: zenoh.Query, send: Callable[[], None]) -> None:
        try:
            with query:  # whoever asked knows that all is said when the question is let go
                send()
        except Exception as error:  # noqa: BLE001  whoever asked is gone, or asked for another key
            self._tell(f"{query.key_expr}: not answered: {error}")


def encoded(answer: dict[str, Any]) -> bytes:
    """As JSON."""
    return json.dumps(answer, ensure_ascii=False, separators=(",", ":")).encode()


JSON = zenoh.Encoding.APPLICATION_JSON
