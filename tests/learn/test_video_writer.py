"""Videos: what is written can be decoded, has the right size and length, and writes over nothing."""

from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("imageio_ffmpeg", reason="make extras EXTRAS=learn")
pytest.importorskip("onnx", reason="make extras EXTRAS=learn")

import imageio_ffmpeg

from tests.support.card_files import STANDING, STANDING_PLAIN, carded, linear
from tests.support.videos import decoded
from twind.config.robot_file import load_robot
from twind.ctl.ctl_main import main
from twind.exceptions import OperationFailed
from twind.learn.environment.camera_renderer import CameraRenderer
from twind.learn.video import video_writer
from twind.learn.video.video_writer import VideoWriter
from twind.twin.binding import bind


@pytest.fixture(scope="module")
def model() -> Any:
    made = mujoco.MjModel.from_xml_path(str(load_robot("h24").mjcf_path))
    try:
        CameraRenderer(made, "torso").close()
    except OperationFailed as reason:
        pytest.skip(str(reason))
    return made


def test_a_video_has_the_pictures_that_were_added(model: Any, tmp_path: Path) -> None:
    data = mujoco.MjData(model)
    writer = VideoWriter(tmp_path / "a.mp4", model, "torso", 20.0)
    for number in range(10):
        data.joint("l_shoulder_pitch").qpos = -0.2 * number
        writer.add(data)
    writer.close()
    frames, size, fps = decoded(tmp_path / "a.mp4")
    assert len(frames) == writer.frames == 10 and size == (640, 480) and fps == pytest.approx(20.0)
    assert np.abs(frames[0].astype(int) - frames[-1].astype(int)).max() > 50  # an arm has moved


@pytest.mark.parametrize("name", ["h24-standing", "so101", "pan-tilt"])
def test_the_robot_fills_the_picture_and_none_of_it_is_cut_off(model: Any, name: str) -> None:
    binding = bind(load_robot(name), None)
    data = mujoco.MjData(binding.model)
    data.qpos[binding.qpos] = binding.rest
    mujoco.mj_forward(binding.model, data)
    renderer = CameraRenderer(binding.model, binding.robot.base)
    pictures = [renderer.take(data).astype(int)]
    robot = binding.model.geom_bodyid > 0
    binding.model.geom_matid[robot] = -1
    binding.model.geom_rgba[robot, 3] = 0.0
    pictures.append(renderer.take(data))
    renderer.close()
    shown = np.abs(pictures[0] - pictures[1]).max(axis=2) > 8
    shares = [np.ptp(np.flatnonzero(shown.any(axis=axis))) / shown.shape[1 - axis] for axis in (0, 1)]
    assert max(shares) > 0.6
    assert not shown[[0, -1]].any()
    assert not shown[:, [0, -1]].any()


def test_a_file_is_not_written_over(model: Any, tmp_path: Path) -> None:
    (tmp_path / "a.mp4").write_text("mine")
    with pytest.raises(OperationFailed, match="is there already"):
        VideoWriter(tmp_path / "a.mp4", model, "torso")
    assert (tmp_path / "a.mp4").read_text() == "mine"


def test_a_link_placed_after_the_file_was_made_is_not_followed(
    model: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "theirs").write_text("theirs")
    path = tmp_path / "a.mp4"
    encode = imageio_ffmpeg.write_frames

    def swapped(*given: Any, **named: Any) -> Any:
        path.rename(tmp_path / "moved.mp4")
        path.symlink_to(tmp_path / "theirs")
        return encode(*given, **named)

    monkeypatch.setattr(imageio_ffmpeg, "write_frames", swapped)
    writer = VideoWriter(path, model, "torso")
    writer.add(mujoco.MjData(model))
    writer.close()
    assert (tmp_path / "theirs").read_text() == "theirs"
    assert len(decoded(tmp_path / "moved.mp4")[0]) == 1


@pytest.mark.parametrize("how", ["does not start", "wrote nothing"])
def test_an_encoder_without_a_picture_leaves_no_file_and_a_second_attempt_succeeds(
    model: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    path = tmp_path / "a.mp4"
    with monkeypatch.context() as patch:
        if how == "wrote nothing":
            encode = partial(imageio_ffmpeg.write_frames, codec="no_codec")
            patch.setattr(imageio_ffmpeg, "write_frames", encode)
        else:
            patch.setenv("IMAGEIO_FFMPEG_EXE", str(tmp_path / "gone"))
        with (
            pytest.raises(OperationFailed, match=rf"a\.mp4: the encoder {how}"),
            closing(VideoWriter(path, model, "torso")) as writer,
        ):
            writer.add(mujoco.MjData(model))
    assert not path.exists()
    writer = VideoWriter(path, model, "torso")
    writer.add(mujoco.MjData(model))
    writer.close()
    assert len(decoded(path)[0]) == 1


def test_without_an_encoder_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video_writer, "find_spec", lambda _name: None)
    with pytest.raises(OperationFailed, match=r"a video needs imageio-ffmpeg: .*learn"):
        video_writer.require_encoder()


def test_a_check_draws_its_drive(model: Any, tmp_path: Path) -> None:
    path = carded(tmp_path, linear(7, 4), STANDING + STANDING_PLAIN)
    out = tmp_path / "drive.mp4"
    assert main(["policy", "check", str(path), "--seconds", "0.4", "--mp4", str(out)]) == 0
    frames, _, fps = decoded(out)
    assert len(frames) == 10 and fps == pytest.approx(25.0)
