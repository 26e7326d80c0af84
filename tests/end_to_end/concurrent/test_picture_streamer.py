"""Pictures of the twin: drawn where the daemon says the joints are, sent with the time of the pose."""

import io
import json
from pathlib import Path

import pytest

pytest.importorskip("PIL", reason="make extras EXTRAS=learn")
pytest.importorskip("OpenGL", reason="make extras EXTRAS=learn")

import numpy as np
from PIL import Image

from tests.support.processes import until
from tests.support.stream_rig import begun, run, streamer
from twind.client import Client
from twind.exceptions import OperationFailed
from twind.learn.streaming.picture_streamer import CameraScene
from twind.learn.streaming.stream_samples import ROWS, StreamSample

__all__ = ["run"]


def seen(jpeg: bytes) -> "np.typing.NDArray[np.float64]":
    return np.asarray(Image.open(io.BytesIO(jpeg)), dtype=float)


def test_a_pose_is_drawn_and_another_pose_looks_otherwise(run: Path) -> None:
    with Client(run, name="observe") as client:
        told = client.call("GetRobot")
    names = [joint["name"] for joint in told["robot"]["joints"]]
    try:
        scene = CameraScene(told)
    except OperationFailed as error:
        pytest.skip(str(error))
    try:
        rest = StreamSample(0.0, 0, names, [[None] * len(names) for _ in ROWS], None)
        bent = rest._replace(rows=[[-1.2 if "elbow" in name else 0.0 for name in names] for _ in ROWS])
        assert scene.fits(rest) and not scene.fits(rest._replace(names=["nose"]))
        first, again, other = (seen(scene.jpeg(each)) for each in (rest, rest, bent))
    finally:
        scene.close()
    assert first.shape == (480, 640, 3)
    assert first.std() > 10.0, "nothing is to be seen"
    assert np.array_equal(first, again)
    assert np.abs(first - other).max() > 50.0


def test_pictures_are_messages_of_their_own_in_the_same_stream(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "in"
    ingest, url = begun(out)
    stream = streamer(
        run, url, tmp_path / "spool", "--camera", "render", "--camera-rate", "5", "--seconds", "20"
    )
    until(lambda: not stream.running or len(list(out.glob("*.jpg"))) >= 2, 20.0, "two pictures")
    code, _, told = stream.end()
    ingest.end()
    if "no pictures: no picture without a display" in told:
        pytest.skip(told)
    kept = [json.loads(line) for line in (out / "messages.ndjson").read_text().splitlines()]
    pictures = [line for line in kept if line.get("twind-camera") == "render"]
    assert code == 0 and len(pictures) >= 2
    assert all(seen((out / line["file"]).read_bytes()).shape == (480, 640, 3) for line in pictures)
    times = {
        round(sample["time"], 6) for line in kept if "body" in line for sample in line["body"]["samples"]
    }
    assert {float(line["twind-monotonic"]) for line in pictures} <= times
    assert sorted(int(line["key"].partition("-")[2]) for line in kept) == list(range(1, len(kept) + 1))
