"""A model in a recording is checked and tried as a robot file's: it costs its reader no memory or time."""

import os
import re
from pathlib import Path

import msgspec
import pytest

from tests.support.sample_recordings import CLOCKS, SESSION, state
from twind.bounded_process import ProcessBounds
from twind.config import model_trial
from twind.config.robot_file import built_in_robots, load_robot
from twind.exceptions import InvalidInput
from twind.gap.recorded_model import recorded_binding
from twind.observe.recording import open_recording
from twind.observe.recording.recording_topics import MJCF
from twind.observe.writing.record_encoder import RecordEncoder
from twind.observe.writing.record_file import RecordFile
from twind.twin import model_from_text
from twind.twin.binding import bind
from twind.twin.model_from_text import compile_model

ROBOT = bind(load_robot("pan-tilt"), None)
HOME = str(ROBOT.robot.mjcf_path.parent)
WORLD = "<worldbody>"
COPIES = (
    '<replicate count="10000"><replicate count="10000"><body><geom size="1"/></body></replicate></replicate>'
)
HOSTILE = [
    ('<option timestep="nan"/>', "option timestep: .*write one number from 0.0001 to 0.1 s"),
    (
        '<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>',
        "hfield nrow: .* 0 to 4096",
    ),
    ('<include file="/dev/zero"/>', "include: a recorded model has no further files"),
    ('<asset><model name="m" file="/dev/zero"/></asset>', "model: a recorded model has no further files"),
    ('<asset><mesh name="q" file="/dev/zero"/></asset>', "mesh: /dev/zero is no file: name a regular one"),
    ("<body>" * 300 + "</body>" * 300, "body: larger than a robot"),
]


def hostile(text: str) -> str:
    """The model of a recording with `text` before, or in, its world."""
    assert WORLD in ROBOT.mjcf
    return ROBOT.mjcf.replace(WORLD, WORLD + text if text.startswith(("<body", "<rep")) else text + WORLD, 1)


@pytest.mark.parametrize(("text", "reason"), HOSTILE)
def test_a_hostile_model_in_a_recording_is_refused_at_its_place(
    tmp_path: Path, text: str, reason: str
) -> None:
    path = tmp_path / "odd.mcap"
    kept = {**SESSION.attachments, MJCF: ("application/xml", hostile(text).encode())}
    file = RecordFile(path, SESSION.about, kept, CLOCKS.wall_ns)
    for line in RecordEncoder(ROBOT.robot.names, CLOCKS).take(state(100.0)):
        file.write(line.topic, line.time_ns, line.data)
    file.finish()
    found = open_recording(path)
    assert found.mjcf is not None
    with pytest.raises(InvalidInput, match=rf"recorded model:\d+:\d+: {reason}") as caught:
        recorded_binding(msgspec.to_builtins(ROBOT.robot, enc_hook=str), found.mjcf)
    assert "\n" not in str(caught.value)


def test_what_no_number_in_the_text_tells_ends_at_the_bounds_of_a_process_of_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(model_trial, "BOUNDS", ProcessBounds(seconds=2, memory=768, output=1))
    with pytest.raises(InvalidInput, match=r"recorded model: (takes|needs) more than .*; make it smaller"):
        compile_model(hostile(COPIES), HOME)


def test_a_model_that_needs_too_much_memory_whole_is_not_compiled_in_parts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without its textures it would fit."""
    monkeypatch.setattr(model_trial, "BOUNDS", ProcessBounds(seconds=20, memory=700, output=1))
    monkeypatch.setattr(model_from_text, "compile_text", lambda *args, **named: pytest.fail("compiled here"))
    flat = 'type="2d" builtin="flat" width="4096" height="4096"'
    textures = "".join(f'<texture name="t{number}" {flat}/>' for number in range(24))
    with pytest.raises(InvalidInput, match=r"recorded model: .*(allocate memory|memory; make it smaller)"):
        compile_model(hostile(f"<asset>{textures}</asset>"), HOME)


def with_mesh(name: str) -> str:
    return hostile(f'<asset><mesh name="q" file="{name}"/></asset>')


def test_an_unreadable_file_is_left_out_of_the_trial_too(monkeypatch: pytest.MonkeyPatch) -> None:
    whole, missing = compile_model(hostile(""), HOME)
    model, left_out = compile_model(with_mesh("gone.stl"), HOME)
    assert left_out and not missing
    assert (model.nmesh, model.nbody) == (0, whole.nbody)
    monkeypatch.setattr(model_trial, "BOUNDS", ProcessBounds(seconds=2, memory=768, output=1))
    with pytest.raises(InvalidInput, match=r"recorded model: (takes|needs) more than .*; make it smaller"):
        compile_model(with_mesh("gone.stl").replace(WORLD, WORLD + COPIES), HOME)


def test_a_file_that_can_be_read_and_is_no_mesh_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "odd.stl"
    path.write_text("no mesh")
    with pytest.raises(InvalidInput, match=r"recorded model: the model cannot be compiled: .*; correct it"):
        compile_model(with_mesh(str(path)), HOME)
    path.unlink()
    assert compile_model(with_mesh(str(path)), HOME)[1]


def test_a_muscle_is_tried_whatever_its_element() -> None:
    """Its range of length is found by a simulation of the model."""
    made = re.sub(r'biastype="affine"', 'biastype="muscle" gaintype="muscle"', ROBOT.mjcf)
    assert made != ROBOT.mjcf
    with pytest.MonkeyPatch.context() as patch:
        asked: list[object] = []
        patch.setattr(model_trial, "call_module", lambda *args, **named: asked.append(args))
        model_trial.require_readable_text(made, Path(HOME))
    assert asked


def test_the_models_that_the_daemon_records_need_no_trial(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model_trial, "call_module", lambda *args, **named: pytest.fail("tried"))
    for name in built_in_robots():
        robot = load_robot(name)
        model, missing = compile_model(bind(robot, None).mjcf, os.path.dirname(robot.mjcf_path))
        assert model.nq and not missing
