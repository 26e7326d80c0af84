"""Writers and readers of one participant, which carry bytes: CDR, header included.

A type here is its name alone. To the library every sample is one octet and whatever follows, so that it
looks at nothing: a malformed message is for those to judge who know what it should be.
"""

from __future__ import annotations

import ctypes as ct
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from twind.bridge.ros.dds.library import TIMEOUT, Descriptor, Piece, SampleInfo, checked
from twind.bridge.ros.dds.names import dds_name, user_data
from twind.bridge.ros.endpoints import Topic
from twind.bridge.ros.goal import LONGEST
from twind.bridge.ros.transport import TransportError
from twind.ros import dds_type

BLOCKING = 5_000_000  # ns that a write may wait for a reader that does not keep up
TAKEN = 16  # samples that are taken at once
_OPAQUE = (0x01_01_00_00, 0, 0)  # DDS_OP_ADR | DDS_OP_TYPE_1BY, at offset 0; DDS_OP_RTS
_DATA, _EVERY = 2, 0x7F  # SDK_DATA; DDS_ANY_STATE
_RELIABLE, _TRANSIENT_LOCAL, _KEEP_LAST, _XCDR1 = 1, 1, 0, 0
_UNLIMITED = -1


class Endpoint:
    """A writer or a reader of one topic."""

    def __init__(self, library: ct.CDLL, participant: int, topic: Topic) -> None:
        """Raises TransportError."""
        self._library, self.topic, name = library, topic, dds_name(topic)
        make = library.dds_create_writer if topic.out else library.dds_create_reader
        with quality(library, topic) as wanted:
            place = library.dds_create_topic(participant, _descriptor(topic), name.encode(), None, None)
            self._place = checked(library, place, f"topic {name}")
            self.entity = checked(library, make(participant, self._place, wanted, None), name)

    def guid(self) -> bytes:
        """16 bytes, as on the wire."""
        return guid(self._library, self.entity)


class Writer(Endpoint):
    """What is written, by any thread."""

    def __init__(self, library: ct.CDLL, participant: int, topic: Topic) -> None:
        """Raises TransportError."""
        super().__init__(library, participant, topic)
        self._lock = threading.Lock()  # nothing is written into a type that is being deleted
        self._type: ct.c_void_p | None = ct.c_void_p()
        found = library.dds_get_entity_sertype(self.entity, ct.byref(self._type))
        checked(library, found, f"type of {dds_name(topic)}")

    def write(self, data: bytes) -> bool:
        """Whether it went out within `BLOCKING`; False: dropped. Raises TransportError."""
        library = self._library
        with self._lock:
            if self._type is None:
                raise TransportError(f"dds: {self.topic.name}: the graph was left")
            piece = Piece(data, len(data))
            sample = library.ddsi_serdata_from_ser_iov(self._type, _DATA, 1, ct.byref(piece), len(data))
            if not sample:
                raise TransportError(f"dds: {self.topic.name}: {len(data)} bytes are no CDR")
            result = library.dds_writecdr(self.entity, sample)
        if result == TIMEOUT:
            return False
        checked(library, result, f"write {self.topic.name}")
        return True

    def close(self) -> None:
        """Write no more."""
        with self._lock:
            self._type = None


class Reader(Endpoint):
    """What has come. For one thread."""

    def __init__(self, library: ct.CDLL, participant: int, topic: Topic) -> None:
        """Raises TransportError."""
        super().__init__(library, participant, topic)
        self._samples, self._told = (ct.c_void_p * TAKEN)(), (SampleInfo * TAKEN)()

    def take(self) -> list[bytes]:
        """The oldest of what has come and was not taken, at most `TAKEN`. Raises TransportError.

        Of one that is too long only so much that it shows: a stop is a stop all the same.
        """
        library = self._library
        count = library.dds_takecdr(self.entity, self._samples, TAKEN, self._told, _EVERY)
        checked(library, count, f"read {self.topic.name}")
        taken = []
        for place in range(count):
            sample = self._samples[place]
            if self._told[place].valid:
                size = min(library.ddsi_serdata_size(sample), LONGEST + 1)
                data = ct.create_string_buffer(size)
                library.ddsi_serdata_to_ser(sample, 0, len(data), data)
                taken.append(data.raw)
            library.ddsi_serdata_unref(sample)
        return taken


def guid(library: ct.CDLL, entity: int) -> bytes:
    """GUID of an entity, 16 bytes as on the wire. Raises TransportError."""
    data = ct.create_string_buffer(16)
    checked(library, library.dds_get_guid(entity, data), "GUID")
    return data.raw


@contextmanager
def quality(library: ct.CDLL, topic: Topic) -> Iterator[ct.c_void_p]:
    """The QoS of one side of a topic."""
    qos = library.dds_create_qos()
    told = user_data(topic)
    library.dds_qset_reliability(qos, _RELIABLE, BLOCKING)
    library.dds_qset_history(qos, _KEEP_LAST, topic.depth)
    library.dds_qset_userdata(qos, told, len(told))
    library.dds_qset_data_representation(qos, 1, (ct.c_int16 * 1)(_XCDR1))
    library.dds_qset_writer_data_lifecycle(qos, False)  # who leaves takes back nothing that was said
    if topic.latched:
        library.dds_qset_durability(qos, _TRANSIENT_LOCAL)
        limits = (_UNLIMITED,) * 3
        library.dds_qset_durability_service(qos, 0, _KEEP_LAST, topic.depth, *limits)
    try:
        yield qos
    finally:
        library.dds_delete_qos(qos)


def _descriptor(topic: Topic) -> Descriptor:
    ops = (ct.c_uint32 * len(_OPAQUE))(*_OPAQUE)
    name = dds_type(topic.kind).encode()
    return Descriptor(size=1, align=1, type_name=name, ops_count=len(ops), ops=ops, meta=b"")
