"""Writers of one participant. They send CDR bytes, header included.

A type is its name alone. The library takes every sample as one octet and the bytes after it, and sends no
information on the structure of the type.
"""

from __future__ import annotations

import ctypes as ct
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from twind.bridge.ros.dds.dds_library import TIMEOUT, IoVector, TopicDescriptor, checked
from twind.bridge.ros.dds.dds_names import dds_name, user_data
from twind.bridge.ros.ros_endpoints import RosTopic
from twind.bridge.ros.ros_names import NodeName
from twind.exceptions import OperationFailed
from twind.ros import dds_type

BLOCKING = 5_000_000  # ns that a write may wait for a reader that does not keep up
_OPAQUE = (0x01_01_00_00, 0, 0)  # DDS_OP_ADR | DDS_OP_TYPE_1BY, at offset 0; DDS_OP_RTS
_DATA = 2  # SDK_DATA
_RELIABLE = 1
_TRANSIENT_LOCAL = 1
_KEEP_LAST = 0
_XCDR1 = 0
_UNLIMITED = -1


class DdsWriter:
    """The writer of one topic. Any thread may write."""

    def __init__(self, library: ct.CDLL, participant: int, topic: RosTopic, node: NodeName) -> None:
        """Raises OperationFailed."""
        self._library = library
        self.topic = topic
        name = dds_name(topic, node)
        with quality(library, topic) as wanted:
            place = library.dds_create_topic(participant, _descriptor(topic), name.encode(), None, None)
            checked(library, place, f"topic {name}")
            entity = library.dds_create_writer(participant, place, wanted, None)
        self._entity = checked(library, entity, name)
        self._lock = threading.Lock()  # no write uses a type that is being deleted
        self._type: ct.c_void_p | None = ct.c_void_p()
        found = library.dds_get_entity_sertype(self._entity, ct.byref(self._type))
        checked(library, found, f"type of {name}")

    def guid(self) -> bytes:
        """16 bytes, as on the wire."""
        return guid(self._library, self._entity)

    def write(self, data: bytes) -> bool:
        """Send CDR bytes; return False if they were dropped after `BLOCKING`. Raises OperationFailed."""
        library = self._library
        with self._lock:
            if self._type is None:
                raise OperationFailed(f"dds: {self.topic.name}: the graph was left")
            piece = IoVector(data, len(data))
            sample = library.ddsi_serdata_from_ser_iov(self._type, _DATA, 1, ct.byref(piece), len(data))
            if not sample:
                raise OperationFailed(f"dds: {self.topic.name}: {len(data)} bytes are no CDR")
            result = library.dds_writecdr(self._entity, sample)
        if result == TIMEOUT:
            return False
        checked(library, result, f"write {self.topic.name}")
        return True

    def close(self) -> None:
        """Write no more."""
        with self._lock:
            self._type = None


def guid(library: ct.CDLL, entity: int) -> bytes:
    """GUID of an entity, 16 bytes as on the wire. Raises OperationFailed."""
    data = ct.create_string_buffer(16)
    checked(library, library.dds_get_guid(entity, data), "GUID")
    return data.raw


@contextmanager
def quality(library: ct.CDLL, topic: RosTopic) -> Iterator[ct.c_void_p]:
    """The QoS of the writer of a topic."""
    qos = library.dds_create_qos()
    data = user_data(topic)
    library.dds_qset_reliability(qos, _RELIABLE, BLOCKING)
    library.dds_qset_history(qos, _KEEP_LAST, topic.depth)
    library.dds_qset_userdata(qos, data, len(data))
    library.dds_qset_data_representation(qos, 1, (ct.c_int16 * 1)(_XCDR1))
    library.dds_qset_writer_data_lifecycle(qos, False)  # leaving does not dispose earlier samples
    if topic.latched:
        library.dds_qset_durability(qos, _TRANSIENT_LOCAL)
        limits = (_UNLIMITED,) * 3
        library.dds_qset_durability_service(qos, 0, _KEEP_LAST, topic.depth, *limits)
    try:
        yield qos
    finally:
        library.dds_delete_qos(qos)


def _descriptor(topic: RosTopic) -> TopicDescriptor:
    ops = (ct.c_uint32 * len(_OPAQUE))(*_OPAQUE)
    name = dds_type(topic.kind).encode()
    return TopicDescriptor(size=1, align=1, type_name=name, ops_count=len(ops), ops=ops, meta=b"")
