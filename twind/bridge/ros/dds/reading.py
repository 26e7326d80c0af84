"""The thread that waits for samples and hands them over."""

from __future__ import annotations

import ctypes as ct
import threading
from collections.abc import Sequence

from twind.bridge.ros.dds.ends import Reader
from twind.bridge.ros.dds.library import checked
from twind.bridge.ros.transport import Heard, TransportError

_EVERY, _FOREVER = 0x7F, (1 << 63) - 1  # DDS_ANY_STATE, DDS_INFINITY


class Reading:
    """What all readers of a participant have, in the order of each topic, until it is ended."""

    def __init__(self, library: ct.CDLL, participant: int, readers: Sequence[Reader], heard: Heard) -> None:
        """Raises TransportError."""
        self._library, self._readers, self._heard = library, readers, heard
        self.lost: TransportError | None = None  # why nothing will be heard any more
        self._set = checked(library, library.dds_create_waitset(participant), "wait set")
        self._end = checked(library, library.dds_create_guardcondition(participant), "guard condition")
        self._attach(self._end, len(readers))
        for place, reader in enumerate(readers):
            condition = library.dds_create_readcondition(reader.entity, _EVERY)
            self._attach(checked(library, condition, f"condition of {reader.topic.name}"), place)
        self._thread = threading.Thread(target=self._run, name="dds", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Hand over no more. Nothing where this thread itself asks, as `heard` may."""
        self._library.dds_set_guardcondition(self._end, True)
        if self._thread is not threading.current_thread():
            self._thread.join()

    def _attach(self, condition: int, place: int) -> None:
        checked(self._library, self._library.dds_waitset_attach(self._set, condition, place), "wait set")

    def _run(self) -> None:
        try:
            self._hand_over()
        except TransportError as error:
            self.lost = error

    def _hand_over(self) -> None:
        found = (ct.c_ssize_t * (len(self._readers) + 1))()
        while True:
            count = self._library.dds_waitset_wait(self._set, found, len(found), _FOREVER)
            checked(self._library, count, "wait for messages")
            places = found[:count]
            if len(self._readers) in places:
                return
            for place in places:
                reader = self._readers[place]
                for data in reader.take():
                    self._heard(reader.topic, data)
