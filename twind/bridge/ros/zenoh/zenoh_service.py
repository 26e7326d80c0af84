"""ROS service over Zenoh: a queryable and its threads; no request waits behind another.

A stop takes effect whatever its request contains: its bytes and its attachment are read only after it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress

import zenoh

from twind.bridge.ros.ros_endpoints import TO_E_STOP, TO_STOP, RosService
from twind.bridge.ros.ros_transport import RequestHandler
from twind.bridge.ros.zenoh.zenoh_attachment import ZenohAttachment, attachment
from twind.exceptions import InvalidInput
from twind.ros import decode, encode

_WAITING = 10  # requests; of more the oldest goes unanswered, as in rmw_zenoh
_STOPS = (TO_STOP, TO_E_STOP)
_AT_ONCE = 4  # stops that are answered beside each other: a second does not wait for a first that hangs


class ZenohServiceServer:
    """Service server. `key`: that of its requests. `tell`: receives a line where an answer fails."""

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
        self._stops = service in _STOPS
        self._requests = session.declare_queryable(key, zenoh.handlers.RingChannel(_WAITING), complete=True)
        self._threads = [
            threading.Thread(target=self._serve, name=f"ros{service.name}", daemon=True)
            for _ in range(_AT_ONCE if self._stops else 1)
        ]
        for thread in self._threads:
            thread.start()

    def close(self, seconds: float) -> None:
        """Take no more requests; wait so long for those that are being answered."""
        with suppress(zenoh.ZError):
            self._requests.undeclare()
        end = time.monotonic() + seconds
        for thread in self._threads:
            thread.join(max(0.0, end - time.monotonic()))

    def _serve(self) -> None:
        for query in self._requests:
            try:
                with query:
                    self._answer(query)
            except zenoh.ZError:
                pass  # the session was closed, or the client is gone
            except Exception as error:  # noqa: BLE001  the next request may be a stop
                self._fault(error)

    def _answer(self, query: zenoh.Query) -> None:
        beside, wrong = _beside(query)
        if beside is None and not self._stops:
            query.reply_err(f"{self._service.name}: {wrong}")
            return
        response = self._response(query)
        if beside is None:
            query.reply(self._key, response)
            return
        reply = ZenohAttachment(beside.number, time.time_ns(), beside.gid, beside.labelled)
        query.reply(self._key, response, attachment=reply.pack())

    def _response(self, query: zenoh.Query) -> bytes:
        """Return the response as CDR. An unreadable request is refused with a text, unless it is a stop."""
        try:
            success, message = self._handle(self._service, None if self._stops else self._data(query))
        except InvalidInput as error:
            success = False
            message = str(error)
        except Exception as error:  # noqa: BLE001  the client gets an answer in any case
            success = False
            message = self._fault(error)
        return encode(f"{self._service.kind}_Response", {"success": success, "message": message})

    def _data(self, query: zenoh.Query) -> bool | None:
        """Return field `data` of the request; None where its type has no such field. Raises InvalidInput."""
        data = b"" if query.payload is None else query.payload.to_bytes()
        value: bool | None = decode(f"{self._service.kind}_Request", data).get("data")
        return value

    def _fault(self, error: Exception) -> str:
        words = f"{type(error).__name__}: {error}"
        self._tell(f"zenoh: {self._service.name}: {words}")
        return words


def _beside(query: zenoh.Query) -> tuple[ZenohAttachment | None, str]:
    """Return the attachment and ""; or None and the error in it."""
    try:
        return attachment(b"" if query.attachment is None else query.attachment.to_bytes()), ""
    except InvalidInput as error:
        return None, str(error)
