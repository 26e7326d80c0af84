"""Waits for samples and hands them over, in a thread for each topic: a stop waits for no trajectory."""

from __future__ import annotations

import ctypes as ct
import threading
from collections.abc import Callable

from twind.bridge.ros.dds.ends import Reader
from twind.bridge.ros.dds.library import checked
from twind.bridge.ros.transport import Heard, TransportError

_EVERY, _FOREVER = 0x7F, (1 << 63) - 1  # DDS_ANY_STATE, DDS_INFINITY
_ENDED, _CAME = 0, 1  # what a wait was for


class Reading:
    """What one reader has, in the order in which it came, until it is ended."""

    def __init__(
        self,
        library: ct.CDLL,
        participant: int,
        reader: Reader,
        heard: Heard,
        tell: Callable[[str], None],
    ) -> None:
        """`tell`: a line where `heard` fails. Raises TransportError."""
        self._library, self._reader, self._heard, self._tell = library, reader, heard, tell
        self.lost: TransportError | None = None  # why nothing will be heard any more
        self._set = checked(library, library.dds_create_waitset(participant), "wait set")
        self._end = checked(library, library.dds_create_guardcondition(participant), "guard condition")
        came = library.dds_create_readcondition(reader.entity, _EVERY)
        self._attach(self._end, _ENDED)
        self._attach(checked(library, came, f"condition of {reader.topic.name}"), _CAME)
        self._thread = threading.Thread(target=self._run, name=f"dds{reader.topic.name}", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Hand over no more. Nothing where this thread itself asks, as `heard` may."""
        self._library.dds_set_guardcondition(self._end, True)
        if self._thread is not threading.current_thread():
            self._thread.join()

    def _attach(self, condition: int, what: int) -> None:
        checked(self._library, self._library.dds_waitset_attach(self._set, condition, what), "wait set")

    def _run(self) -> None:
        try:
            self._hand_over()
        except TransportError as error:
            self.lost = error
        except Exception as error:  # noqa: BLE001  no memory: who publishes hears it, and joins anew
            self.lost = TransportError(f"dds: {self._reader.topic.name}: {type(error).__name__}: {error}")

    def _hand_over(self) -> None:
        found = (ct.c_ssize_t * 2)()
        while True:
            count = self._library.dds_waitset_wait(self._set, found, len(found), _FOREVER)
            if _ENDED in found[: checked(self._library, count, "wait for messages")]:
                return
            for data in self._reader.take():
                self._say(data)

    def _say(self, data: bytes) -> None:
        topic = self._reader.topic
        try:
            self._heard(topic, data)
        except Exception as error:  # noqa: BLE001  the next message may be a stop
            self._tell(f"dds: {topic.name}: a message was lost: {type(error).__name__}: {error}")
