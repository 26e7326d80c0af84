"""One service of ROS over Zenoh: a queryable and a thread that answers, so that none waits behind another."""

from __future__ import annotations

import threading
import time
from contextlib import suppress

import zenoh

from twind.bridge.ros.endpoints import Service
from twind.bridge.ros.transport import Asked
from twind.bridge.ros.zenoh.attachment import Attachment, AttachmentError, attachment
from twind.ros import CdrError, decode, encode

_WAITING = 10  # requests; of more the oldest goes unanswered, as in rmw_zenoh


class Served:
    """Answers until it is closed. `key`: where its requests come."""

    def __init__(self, session: zenoh.Session, service: Service, key: str, asked: Asked) -> None:
        self._service, self._key, self._asked = service, key, asked
        self._requests = session.declare_queryable(key, zenoh.handlers.RingChannel(_WAITING), complete=True)
        self._thread = threading.Thread(target=self._serve, name=f"ros{service.name}", daemon=True)
        self._thread.start()

    def close(self, seconds: float) -> None:
        """No more requests; waits so long for the one that is being answered."""
        with suppress(zenoh.ZError):
            self._requests.undeclare()
        self._thread.join(seconds)

    def _serve(self) -> None:
        for query in self._requests:
            with suppress(zenoh.ZError), query:  # the session was closed, or who asked is gone
                self._answer(query)

    def _answer(self, query: zenoh.Query) -> None:
        try:
            told = attachment(b"" if query.attachment is None else query.attachment.to_bytes())
        except AttachmentError as error:
            query.reply_err(f"{self._service.name}: {error}")
            return
        reply = Attachment(told.number, time.time_ns(), told.gid, told.labelled)
        query.reply(self._key, self._response(query), attachment=reply.pack())

    def _response(self, query: zenoh.Query) -> bytes:
        """CDR. What cannot be read is refused in words."""
        data = b"" if query.payload is None else query.payload.to_bytes()
        try:
            request = decode(f"{self._service.kind}_Request", data)
        except CdrError as error:
            success, message = False, str(error)
        else:
            success, message = self._asked(self._service, request.get("data"))
        return encode(f"{self._service.kind}_Response", {"success": success, "message": message})
