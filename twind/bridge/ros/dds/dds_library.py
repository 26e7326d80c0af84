"""Binding of Cyclone DDS's C library for untyped bytes: topics without a type, samples as CDR.

The Python classes of `cyclonedds` are not used. They send the type's structure along in discovery, and Fast
DDS 3 (Kilted and later) then matches only a peer with the same hash of it, without a report: measured,
0 of 400 messages. Without that information both sides match by the type's name, as ROS itself does.
Layouts are those of cyclonedds 11.0.1: dds.h, dds_public_impl.h, dds_opcodes.h, ddsi_serdata.h.
"""

from __future__ import annotations

import ctypes as ct
import importlib.metadata
import importlib.util
import runpy
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from twind.command_line.extras import how_to_add
from twind.exceptions import OperationFailed

KNOWN = "11.0.1"  # the version whose layouts these are; they were compared with no other
TIMEOUT = -10  # DDS_RETCODE_TIMEOUT


class _ByteSequence(ct.Structure):  # struct dds_type_meta_ser
    _fields_ = (("data", ct.c_char_p), ("size", ct.c_uint32))


class TopicDescriptor(ct.Structure):
    """Type descriptor: dds_topic_descriptor_t."""

    _fields_ = (
        *((name, ct.c_uint32) for name in ("size", "align", "flags", "keys_count")),
        ("type_name", ct.c_char_p),
        ("keys", ct.c_void_p),
        ("ops_count", ct.c_uint32),
        ("ops", ct.POINTER(ct.c_uint32)),
        ("meta", ct.c_char_p),
        ("type_information", _ByteSequence),
        ("type_mapping", _ByteSequence),
        ("representations", ct.c_uint32),
        ("member_ids", ct.c_uint32),
    )


class IoVector(ct.Structure):
    """Some bytes: struct iovec."""

    _fields_ = (("base", ct.c_char_p), ("length", ct.c_size_t))


_ENTITY = ct.c_int32
_POINTER = ct.c_void_p
_TEXT = ct.c_char_p
# name -> (result, arguments); an entity below zero, and a result below zero, is an error
_FUNCTIONS: Mapping[str, tuple[Any, tuple[Any, ...]]] = {
    "dds_create_domain": (_ENTITY, (ct.c_uint32, _TEXT)),
    "dds_create_participant": (_ENTITY, (ct.c_uint32, _POINTER, _POINTER)),
    "dds_create_topic": (_ENTITY, (_ENTITY, ct.POINTER(TopicDescriptor), _TEXT, _POINTER, _POINTER)),
    "dds_create_writer": (_ENTITY, (_ENTITY, _ENTITY, _POINTER, _POINTER)),
    "dds_delete": (ct.c_int32, (_ENTITY,)),
    "dds_get_guid": (ct.c_int32, (_ENTITY, _POINTER)),
    "dds_get_entity_sertype": (ct.c_int32, (_ENTITY, ct.POINTER(_POINTER))),
    "dds_strretcode": (_TEXT, (ct.c_int32,)),
    "dds_create_qos": (_POINTER, ()),
    "dds_delete_qos": (None, (_POINTER,)),
    "dds_qset_reliability": (None, (_POINTER, ct.c_int, ct.c_int64)),
    "dds_qset_durability": (None, (_POINTER, ct.c_int)),
    "dds_qset_history": (None, (_POINTER, ct.c_int, ct.c_int32)),
    "dds_qset_durability_service": (None, (_POINTER, ct.c_int64, ct.c_int, *(ct.c_int32,) * 4)),
    "dds_qset_writer_data_lifecycle": (None, (_POINTER, ct.c_bool)),
    "dds_qset_data_representation": (None, (_POINTER, ct.c_uint32, ct.POINTER(ct.c_int16))),
    "dds_qset_userdata": (None, (_POINTER, _TEXT, ct.c_size_t)),
    "dds_writecdr": (ct.c_int32, (_ENTITY, _POINTER)),
    "ddsi_serdata_from_ser_iov": (
        _POINTER,
        (_POINTER, ct.c_int, ct.c_size_t, ct.POINTER(IoVector), ct.c_size_t),
    ),
}


def _remedy() -> str:
    return f"{how_to_add('dds')}; or --backend zenoh, rclpy"


def load() -> ct.CDLL:
    """The library of the installed `cyclonedds`. Raises OperationFailed: none, or one of unknown layout."""
    found = importlib.util.find_spec("cyclonedds")
    if found is None or not found.submodule_search_locations:
        raise OperationFailed(f"dds: the package cyclonedds is missing: {_remedy()}")
    version = importlib.metadata.version("cyclonedds")
    if version != KNOWN:
        raise OperationFailed(f"dds: cyclonedds {version} is installed, must be {KNOWN}: {_remedy()}")
    # It names the path of the library; the package itself takes 0.16 s of CPU to import.
    where = runpy.run_path(str(Path(found.submodule_search_locations[0], "__library__.py")))["library_path"]
    library = ct.CDLL(str(where))  # each call releases the interpreter's lock
    for name, (result, arguments) in _FUNCTIONS.items():
        function = getattr(library, name)
        function.restype = result
        function.argtypes = arguments
    return library


def checked(library: ct.CDLL, result: int, doing: str) -> int:
    """Return `result` if it is no error. Raises OperationFailed, which names `doing`."""
    if result < 0:
        raise OperationFailed(f"dds: {doing}: {library.dds_strretcode(result).decode()}")
    return result
