"""Imports that are refused: one line with file, line and remedy, and nothing is written."""

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.model_files import DATA, copied_models, read_here
from twind.bounded_process import ProcessBounds
from twind.exceptions import InvalidInput
from twind_calibration.model_import import import_model as entry
from twind_calibration.model_import.import_model import import_model

LINK = '<link name="{}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>'
BOMB = '<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
ELBOW = '<joint name="elbow" type="revolute">'

# What is changed in arm.urdf, and the message after the name of the file.
CHANGES = {
    "missing mesh": (
        '<box size="0.03 0.03 0.14"/>',
        '<mesh filename="package://arm/no.stl"/>',
        r":17:\d+: package 'arm' is in no folder above the file and not in ROS_PACKAGE_PATH.*arm=FOLDER",
    ),
    "missing mesh of a path": (
        '<box size="0.03 0.03 0.14"/>',
        '<mesh filename="meshes/no.stl"/>',
        r":17:\d+: .*/meshes/no.stl: No such file or directory; give the path of a file that exists",
    ),
    "mesh of an unknown format": (
        '<box size="0.03 0.03 0.14"/>',
        '<mesh filename="arm.urdf"/>',
        r":17:\d+: mesh .*arm.urdf: format 'urdf' is not read; convert it to stl, obj, dae, ply",
    ),
    "mesh in millimetres": (
        '<box size="0.03 0.03 0.14"/>',
        '<mesh filename="meshes/ball.stl" scale="20 20 20"/>',
        r":17:\d+: mesh ball.stl: 40 m long, at most 20 m; write its scale, 0.001",
    ),
    "two roots": (
        "</robot>",
        LINK.format("spare") + "</robot>",
        r":29:1: 2 root links: base_link, spare; join them",
    ),
    "unknown type": (
        ELBOW,
        ELBOW.replace("revolute", "hinge"),
        r":24:3: joint 'elbow': unknown type 'hinge'; types are",
    ),
    "planar": (
        ELBOW,
        ELBOW.replace("revolute", "planar"),
        r":24:3: joint 'elbow': type planar: only joints with one",
    ),
    "floating": (
        ELBOW,
        ELBOW.replace("revolute", "floating"),
        r":24:3: joint 'elbow': type floating: only joints",
    ),
    "cycle": (
        '<parent link="base_link"/>',
        '<parent link="tool"/>',
        r":\d+:3: link '\w+' is its own ancestor: a cycle",
    ),
    "two parents": (
        '<child link="tool"/>',
        '<child link="upper"/>',
        r":28:3: link 'upper' is the child of two joints",
    ),
    "duplicated link": (
        '<link name="tool"/>',
        '<link name="upper"/>',
        r":19:3: link 'upper' stands twice, first at .*:9:3",
    ),
    "duplicated joint": (ELBOW, ELBOW.replace("elbow", "shoulder"), r":24:3: joint 'shoulder' stands twice"),
    "degrees": (
        'lower="-1.5" upper="1.4"',
        'lower="-90" upper="80"',
        r":22:5: joint 'shoulder': limits -90..80 look like deg",
    ),
    "no limits": (
        '<limit lower="-1.5" upper="1.4" effort="3.5" velocity="5.2"/>',
        "",
        r":20:3: joint 'shoulder': no <limit>",
    ),
    "empty limits": (
        'lower="-1.5" upper="1.4"',
        "",
        r":22:5: joint 'shoulder': limits: lower 0 must be below upper 0",
    ),
    "inertia": (
        'ixx="0.0012" ixy="0.0001"',
        'ixx="0.0012" ixy="0.1"',
        r":6:7: link 'base_link': inertia is not positive def",
    ),
    "mass zero": (
        '<mass value="0.25"/>',
        '<mass value="0"/>',
        r":9:3: link 'upper': moved by joint 'shoulder', has mass 0",
    ),
    "mass below zero": (
        '<mass value="0.25"/>',
        '<mass value="-1"/>',
        r":10:5: link 'upper': mass -1 kg is below 0",
    ),
    "mimic of itself": (
        'mimic joint="shoulder"',
        'mimic joint="elbow"',
        r":26:\d+: mimic joints follow each other in a cycle",
    ),
    "mimic of none": (
        'mimic joint="shoulder"',
        'mimic joint="tip"',
        r":26:\d+: joint 'elbow' mimics 'tip', no joint that",
    ),
    "unknown link": (
        '<child link="tool"/>',
        '<child link="tol"/>',
        r":28:3: joint 'tip': child link 'tol' does not exist",
    ),
    "no number": (
        '<mass value="0.25"/>',
        '<mass value="x"/>',
        r":10:\d+: <mass>: value='x': one number must stand here",
    ),
    "no finite number": (
        '<mass value="0.25"/>',
        '<mass value="nan"/>',
        r":10:\d+: <mass>: value='nan': one number",
    ),
    "axis": ('xyz="0.3 1 0.2"', 'xyz="0 0 0"', r":21:\d+: joint 'shoulder': axis 0 0 0 has no direction"),
    "shape": ('<box size="0.03 0.03 0.14"/>', "<cone/>", r":17:\d+: unknown shape <cone>; shapes are box"),
    "entities": ('<?xml version="1.0"?>', BOMB, r":1:\d+: DOCTYPE and entities are not read"),
    "not well-formed": ("</robot>", "", r":30:1: no well-formed XML: no element found"),
    "another kind": (
        '<robot name="arm">',
        '<sdf name="arm">',
        r":29:\d+: no well-formed XML: mismatched tag",
    ),
}


def changed(tmp_path: Path, old: str, new: str, name: str = "arm.urdf") -> Path:
    path = copied_models(tmp_path) / name
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    return path


def refusal_of(path: Path, tmp_path: Path, **given: object) -> str:
    with pytest.raises(InvalidInput) as caught:
        read_here(path, tmp_path / "new", **given)
    assert not (tmp_path / "new").exists()
    message = str(caught.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize("change", CHANGES)
def test_a_wrong_urdf_is_refused_in_one_line_with_its_place(tmp_path: Path, change: str) -> None:
    old, new, expected = CHANGES[change]
    path = changed(tmp_path, old, new)
    message = refusal_of(path, tmp_path)
    assert re.match(re.escape(str(path)) + expected, message), message


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            '<compiler angle="radian" ',
            "<compiler ",
            r":13:9: joint 'knuckle': range -1 1 is taken as degrees, but looks",
        ),
        ('range="-1 1"', 'range="-90 90"', r":13:9: joint 'knuckle': range -90 90 rad looks like degrees"),
        ('file="ball.stl"', 'file="bull.stl"', r":4:5: mesh .*/meshes/bull.stl: No such file"),
        ('type="capsule"', 'type="cone"', r":15: MuJoCo: XML Error: .*invalid.*"),
        (
            '<geom name="floor" type="plane" size="1 1 1"/>',
            '<include file="finger.xml"/>',
            r".*more than 100 files",
        ),
        ('name="distal"', 'name="palm"', r":16: MuJoCo: .*repeated name.*"),
    ],
)
def test_a_wrong_mjcf_is_refused_in_one_line_with_its_place(
    tmp_path: Path, old: str, new: str, expected: str
) -> None:
    path = changed(tmp_path, old, new, "finger.xml")
    message = refusal_of(path, tmp_path)
    assert re.match(re.escape(str(path)) + expected, message), message


def test_a_mesh_that_is_none_is_refused(tmp_path: Path) -> None:
    path = changed(tmp_path, '<box size="0.03 0.03 0.14"/>', '<mesh filename="meshes/ball.stl"/>')
    (path.parent / "meshes" / "ball.stl").write_bytes(b"solid x\nno facets\n")
    assert re.search(r"arm.urdf:17:\d+: mesh .*ball.stl: .*export it again$", refusal_of(path, tmp_path))


def test_a_file_that_exists_is_not_overwritten(tmp_path: Path) -> None:
    path = copied_models(tmp_path) / "arm.urdf"
    read_here(path, tmp_path / "out")
    with pytest.raises(InvalidInput, match=r"out/arm.xml: the file exists; name another folder"):
        read_here(path, tmp_path / "out")


def test_an_import_that_takes_too_long_or_too_much_memory_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = copied_models(tmp_path) / "arm.urdf"
    monkeypatch.setattr(entry, "BOUNDS", ProcessBounds(seconds=0, memory=4096, output=1))
    with pytest.raises(InvalidInput, match=r"arm.urdf: takes more than 0 s; make it smaller"):
        import_model(path, tmp_path / "new")


@given(data=st.data())
@examples(100)
def test_a_mutated_file_is_refused_or_becomes_a_model_that_compiles(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    name = data.draw(st.sampled_from(["arm.urdf", "finger.xml"]))
    text = (DATA / name).read_text()
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text) - 1))
        cut = data.draw(st.integers(0, 40))
        words = st.sampled_from(
            ["", "0", "-1", "1e9", "nan", '"', "<", "/>", "upper", "elbow", "fixed", text[:cut]]
        )
        text = text[:start] + data.draw(words) + text[start + cut :]
    folder = tmp_path_factory.mktemp("mutated")
    path = copied_models(folder) / name
    path.write_text(text)
    try:
        model = read_here(path, folder / "new")
    except InvalidInput as error:
        message = str(error)
    else:
        message = ""
        assert model.joints
        assert model.mass > 0.0
    assert "\n" not in message
