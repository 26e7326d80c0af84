"""`record.*`: what a message of a recording costs, from the numbers to the disk, and how large an hour is."""

import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from bench.harness import (
    ROUNDS,
    FigureSpec,
    MeasuredFigure,
    Measurement,
    cpu_per_call,
    interleaved,
    medians,
    spread,
)
from twind.observe.writing.record_file import RecordFile
from twind.ros import JOINT_STATE, JointStateBuffer, definition_text, stamp

# a minute of one topic
MESSAGES = 6000
RATE = 100.0
FLUSH = 150  # messages: half a second of three topics, as `twindctl record` ends its chunks
NAMES = [f"{side}_{part}_{place}" for side in ("l", "r") for part in ("arm", "leg") for place in range(6)]
START = 1_795_000_000_000_000_000
TICK = 2.0 * np.pi / 4096.0  # rad: what an encoder of these servos tells
# rad/s and N·m of one count
SPEED = 0.229 * 2.0 * np.pi / 60.0
CURRENT = 0.01
TOPIC = "/hw/joint_states"
Row = tuple[list[float], list[float], list[float]]


def rows() -> list[Row]:
    """A robot that walks: sines of a second, as its servos tell them, each with a count or two of noise."""
    random = np.random.default_rng(7)
    time = np.arange(MESSAGES)[:, None] / RATE
    phase = random.uniform(0.0, 6.28, 24)
    size = random.uniform(0.05, 0.6, 24)
    angle = size * np.sin(6.28 * time + phase)
    speed = 6.28 * size * np.cos(6.28 * time + phase)
    noise = [random.normal(0.0, share, (MESSAGES, 24)) for share in (0.7, 1.5, 4.0)]
    columns = [
        np.round(exact / count + part) * count
        for exact, count, part in zip((angle, speed, 2.0 * angle), (TICK, SPEED, CURRENT), noise, strict=True)
    ]
    return [tuple(column[place].tolist() for column in columns) for place in range(MESSAGES)]  # type: ignore[misc]


def when(place: int) -> int:
    """Log time (ns) of a message."""
    return START + round(place * 1e9 / RATE)


def ours(data: list[Row], folder: Path) -> float:
    """CPU (s) of one message: numbers to CDR, into a zstd chunk, each half a second to the disk."""
    file = RecordFile(_new(folder), {}, {}, START)
    buffer = JointStateBuffer(NAMES, velocity=True, effort=True)

    def one(place: int) -> None:
        time = when(place)
        file.write(TOPIC, time, buffer.fill(time, *data[place]))
        if place % FLUSH == FLUSH - 1:
            file.flush()

    try:
        return cpu_per_call(one, MESSAGES)
    finally:
        file.finish()


def by_mcap_ros2(writer: Any, data: list[Row], folder: Path) -> float:
    """The same with the writer of mcap-ros2-support: it encodes by the definition, chunks of 1 MiB."""
    with _new(folder).open("xb") as stream:
        out = writer.Writer(stream)
        schema = out.register_msgdef(JOINT_STATE, definition_text(JOINT_STATE))

        def one(place: int) -> None:
            out.write_message(TOPIC, schema, _plain(place, data[place]), log_time=when(place))

        try:
            return cpu_per_call(one, MESSAGES)
        finally:
            out.finish()


def by_rosbags(rosbag2: Any, typesys: Any, data: list[Row], folder: Path) -> float:
    """The same with rosbags: its encoder, its MCAP writer, which does not compress."""
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    state, header, time = (
        store.types[name] for name in (JOINT_STATE, "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    path = _new(folder).with_suffix("")
    with rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as bag:
        topic = bag.add_connection(TOPIC, JOINT_STATE, typestore=store)

        def one(place: int) -> None:
            head = header(time(**stamp(when(place))), "")
            message = state(head, NAMES, *(np.array(column) for column in data[place]))
            bag.write(topic, when(place), store.serialize_cdr(message, JOINT_STATE))

        return cpu_per_call(one, MESSAGES)


def _plain(place: int, row: Row) -> dict[str, Any]:
    position, velocity, effort = row
    head = {"stamp": stamp(when(place)), "frame_id": ""}
    return {"header": head, "name": NAMES, "position": position, "velocity": velocity, "effort": effort}


def _new(folder: Path) -> Path:
    return folder / f"{len(list(folder.iterdir()))}.mcap"


def _peers(data: list[Row], folder: Path) -> dict[str, Callable[[], float]]:
    """Those that are installed."""
    found: dict[str, Callable[[], float]] = {}
    with suppress(ImportError):
        found["mcap-ros2-support"] = partial(by_mcap_ros2, import_module("mcap_ros2.writer"), data, folder)
    with suppress(ImportError):
        modules = import_module("rosbags.rosbag2"), import_module("rosbags.typesys")
        found["rosbags"] = partial(by_rosbags, *modules, data, folder)
    return found


def cost() -> Mapping[str, MeasuredFigure]:
    """Both figures."""
    data = rows()
    with tempfile.TemporaryDirectory(prefix="twind-bench-") as name:
        folder = Path(name)
        takes = {"twind": partial(ours, data, folder), **_peers(data, folder)}
        taken = interleaved(ROUNDS, takes)
        middle = medians({key: [each * 1e6 for each in values] for key, values in taken.items()})
        size = _size(data, folder)
    peers: dict[str, float | None] = {"mcap-ros2-support": None, "rosbags": None}
    peers |= {key: value for key, value in middle.items() if key != "twind"}
    note = (
        "JointState of 24 joints, position, velocity and effort with noise, zstd, a chunk each half second; "
    )
    note += spread([each * 1e6 for each in taken["twind"]], "µs")
    hour = size * 3600.0 * RATE / MESSAGES / 1e6
    told = f"the same messages at {RATE:g} Hz; {size / MESSAGES:.0f} B each in the file, {_raw()} B before"
    return {
        "record.cost_per_message": MeasuredFigure(middle["twind"], note, peers),
        "record.megabytes_per_hour": MeasuredFigure(hour, told),
    }


def _size(data: list[Row], folder: Path) -> int:
    """Bytes of a minute of them."""
    path = _new(folder)
    file = RecordFile(path, {}, {}, START)
    buffer = JointStateBuffer(NAMES, velocity=True, effort=True)
    for place, row in enumerate(data):
        file.write(TOPIC, when(place), buffer.fill(when(place), *row))
        if place % FLUSH == FLUSH - 1:
            file.flush()
    file.finish()
    return path.stat().st_size


def _raw() -> int:
    zeros = [0.0] * len(NAMES)
    return len(JointStateBuffer(NAMES, velocity=True, effort=True).fill(0, zeros, zeros, zeros))


MEASUREMENTS = (
    Measurement(
        {
            "record.cost_per_message": FigureSpec("µs", "≤ 15"),
            "record.megabytes_per_hour": FigureSpec("MB/h"),
        },
        cost,
    ),
)
