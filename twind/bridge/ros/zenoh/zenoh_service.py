"""ROS service over Zenoh: a queryable, whose requests wait in no thread of the engine.

A stop takes effect whatever its request contains: its bytes and its attachment are not needed for it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial

import zenoh

from twind.bridge.ros.ros_endpoints import TO_E_STOP, TO_STOP, RosService
from twind.bridge.ros.ros_transport import RequestHandler
from twind.bridge.ros.zenoh.zenoh_attachment import ZenohAttachment, attachment
from twind.exceptions import InvalidInput
from twind.ros import decode, encode

_STOPS = (TO_STOP, TO_E_STOP)
_LONGEST = 1024  # bytes of a request


class ZenohServiceServer:
    """Service server. `key`: that of its requests. `tell`: receives a line where a request fails."""

    def __init__(
        self,
        session: zenoh.Session,
        service: RosService,
        key: str,
        asked: RequestHandler,
        tell: Callable[[str], None],
    ) -> None:
        self._service = service
        self._key = key
        self._handle = asked
        self._tell = tell
        callback = zenoh.handlers.Callback(self._take, indirect=False)
        self._requests = session.declare_queryable(key, callback, complete=True)

    def close(self) -> None:
        """Take no more requests."""
        with suppress(zenoh.ZError):
            self._requests.undeclare()

    def _take(self, query: zenoh.Query) -> None:
        beside: ZenohAttachment | None = None
        try:
            beside = attachment(b"" if query.attachment is None else query.attachment.to_bytes())
        except InvalidInput as error:
            if self._service not in _STOPS:
                with query, suppress(zenoh.ZError):
                    query.reply_err(f"{self._service.name}: {error}")
                return
        reply = partial(self._reply, query, beside)
        try:
            self._handle(self._service, None if self._service in _STOPS else self._data(query), reply)
        except InvalidInput as error:
            reply(False, str(error))
        except Exception as error:  # noqa: BLE001  the client gets an answer in any case
            text = f"{type(error).__name__}: {error}"
            self._tell(f"zenoh: {self._service.name}: {text}")
            reply(False, text)

    def _data(self, query: zenoh.Query) -> bool | None:
        """Return field `data` of the request; None where its type has no such field. Raises InvalidInput."""
        payload = query.payload
        if payload is not None and len(payload) > _LONGEST:
            raise InvalidInput(f"{len(payload)} bytes, bound {_LONGEST}")
        data = b"" if payload is None else payload.to_bytes()
        value: bool | None = decode(f"{self._service.kind}_Request", data).get("data")
        return value

    def _reply(self, query: zenoh.Query, beside: ZenohAttachment | None, success: bool, text: str) -> None:
        response = encode(f"{self._service.kind}_Response", {"success": success, "message": text})
        reply = None if beside is None else ZenohAttachment(beside.number, time.time_ns(), beside.gid).pack()
        with query, suppress(zenoh.ZError):  # the session was closed, or the client is gone
            query.reply(self._key, response, attachment=reply)
