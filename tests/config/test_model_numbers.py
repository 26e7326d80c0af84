"""A number of `<option>`, `<compiler>` or `<size>` that is not finite or absurd is refused with its place."""

import re
from contextlib import suppress
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import mujoco
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.doc_pages_text import ROOT
from twind import cli
from twind.config.model_numbers import BOUNDS, require_sane_numbers
from twind.config.robot_file import built_in_robots, load_robot
from twind.config.yaml_tree import ConfigError
from twind.ctl.ctl_main import main as ctl
from twind.virtual.virtual_main import main as virtual

ATTRIBUTES = [(element, name) for element, known in BOUNDS.items() for name in known]
BODY = '<worldbody><body><freejoint/><geom size="1"/></body></worldbody>'
NOT_NUMBERS = ("nan", "-nan", "NaN(1)", "inf", "-inf", "Infinity", "1e400", "-1e400", "0x10", "0b1", "1_0")
NOT_NUMBERS += ("", "  ", "abc", "1,2", "1e", "--1", "1.5.2", "9" * 5000, "\u0661", "1\ny", "10E", "1.5M")
H24 = load_robot("h24")


def written(path: Path, element: str, name: str, value: str, *, before: str = "") -> tuple[Path, int, int]:
    """A small model with one attribute; its path, and the line and column of the attribute."""
    indent = f"  <{element} "
    inner = f"{before}\n{indent}{name}={quoteattr(value)}/>\n"
    inner = f"<compiler>{inner}</compiler>" if element == "lengthrange" else inner
    path.write_text(f"<mujoco>{inner}{BODY}</mujoco>\n")
    return path, before.count("\n") + 2, len(indent) + 1


def refused(path: Path) -> ConfigError:
    with pytest.raises(ConfigError) as caught:
        require_sane_numbers(path)
    return caught.value


def robot_with(folder: Path, option: str) -> Path:
    """h24's robot file beside a model with another `<option>`; the path of the robot file."""
    text, found = re.subn(r"<option [^>]*/>", option, H24.mjcf)
    assert found == 1
    (folder / "h24.xml").write_text(text)
    (folder / "odd.yaml").write_text(H24.path.read_text())
    return folder / "odd.yaml"


@st.composite
def absurd(draw: st.DrawFn) -> tuple[str, str, str]:
    """An element, one of its attributes, and a value that is not finite, malformed or out of bounds."""
    element, name = draw(st.sampled_from(ATTRIBUTES))
    bound = BOUNDS[element][name]
    kind = draw(st.sampled_from(("text", "number", "many")))
    if kind == "many":
        return element, name, " ".join([f"{bound.most:.0f}"] * (bound.count + 1))
    if kind == "text":
        return element, name, draw(st.sampled_from(NOT_NUMBERS))
    numbers = st.integers(-(10**20), 10**20) if bound.whole else st.floats()
    return element, name, repr(draw(numbers.filter(lambda each: each not in bound)))


@given(absurd())
def test_any_absurd_number_of_any_attribute_is_refused_at_its_place(
    tmp_path_factory: pytest.TempPathFactory, drawn: tuple[str, str, str]
) -> None:
    element, name, value = drawn
    path, line, column = written(tmp_path_factory.getbasetemp() / "absurd.xml", element, name, value)
    error = refused(path)
    assert (error.file, error.line, error.column) == (str(path), line, column)
    assert error.path == f"{element} {name}"
    assert "\n" not in str(error) and "write " in error.message and "remove the attribute" in error.message


@given(st.sampled_from(ATTRIBUTES), st.data())
def test_any_number_inside_its_bounds_passes(
    tmp_path_factory: pytest.TempPathFactory, attribute: tuple[str, str], data: Any
) -> None:
    bound = BOUNDS[attribute[0]][attribute[1]]
    number = data.draw(
        st.integers(int(bound.least), int(bound.most))
        if bound.whole
        else st.floats(bound.least, bound.most).map(lambda each: repr(float(each)))
    )
    value = " ".join([str(number)] * data.draw(st.integers(1, bound.count)))
    require_sane_numbers(written(tmp_path_factory.getbasetemp() / "sane.xml", *attribute, value)[0])


@pytest.mark.parametrize("robot", built_in_robots())
def test_every_built_in_robot_passes(robot: str) -> None:
    require_sane_numbers(load_robot(robot).mjcf_path)


def test_every_number_attribute_of_the_mujoco_schema_has_bounds() -> None:
    words = {
        "compiler": "alignfree angle assetdir autolimits balanceinertia conflict coordinate discardvisual "
        "eulerseq fitaabb fusestatic inertiafromgeom meshdir passthrough savecanonical savecompiled "
        "saveinertial strippath texturedir usethread",
        "lengthrange": "mode useexisting uselimit",
        "option": "cone integrator jacobian solver",
        "size": "",
    }
    schema = schema_of(mujoco.mj_printSchema(False, False))
    for element, known in BOUNDS.items():
        assert schema[element] - set(words[element].split()) == set(known), element


def test_the_page_states_the_bounds_that_hold() -> None:
    page = (ROOT / "docs" / "configuration.md").read_text().partition("### Numbers of the model")[2]
    rows = re.findall(r"^\| `(\w+) (\w+)` \| ([^|]+) \|", page.partition("\n## ")[0], re.MULTILINE)
    assert len(rows) == 5
    for element, name, bound in rows:
        assert bound == str(BOUNDS[element][name])


def schema_of(text: str) -> dict[str, set[str]]:
    """Attributes by element, from MuJoCo's table; the first element of a name counts."""
    found: dict[str, set[str]] = {}
    element = ""
    for line in text.splitlines():
        named = re.match(r" *(\w+) \([*!?+R]\) +(.*)", line)
        if named:
            element = named[1] if named[1] not in found else "another"
        found.setdefault(element, set()).update((named[2] if named else line).split())
    return found


def test_every_one_of_several_options_is_checked(tmp_path: Path) -> None:
    before = '<option timestep="0.002"/>\n<option gravity="0 0 -9.81"/>'
    path, line, column = written(tmp_path / "m.xml", "option", "timestep", "nan", before=before)
    assert (refused(path).line, refused(path).column) == (line, column) == (3, 11)


def test_the_place_is_that_of_the_attribute_not_of_the_element(tmp_path: Path) -> None:
    path = tmp_path / "m.xml"
    path.write_bytes(
        b"\xef\xbb\xbf<?xml version='1.0' encoding='ascii'?>\r\n<!-- -- \xe9\r\n -->\r\n"
        b"<mujoco model='\xc3\xa9'>\r\n<option integrator='RK4'\r\n"
        b"  solver='timestep' cone='elliptic' timestep  =  'nan'/></mujoco>"
    )
    error = refused(path)
    assert (error.line, error.column) == (6, 37)


def test_a_comment_is_not_checked(tmp_path: Path) -> None:
    path, _, _ = written(
        tmp_path / "m.xml", "option", "timestep", "0.002", before='<!-- a -- <option timestep="nan"/> -->'
    )
    require_sane_numbers(path)


def test_a_file_of_comments_that_never_end_takes_no_quadratic_time(tmp_path: Path) -> None:
    path = tmp_path / "m.xml"
    path.write_bytes(b"<mujoco>" + b"<!--" * (1 << 20))
    assert "not XML" in refused(path).message


def test_an_included_file_is_found_where_mujoco_finds_it_and_refused_by_its_name(tmp_path: Path) -> None:
    main = tmp_path / "main.xml"
    inner = tmp_path / "parts" / "deep"
    inner.mkdir(parents=True)
    main.write_text(f'<mujoco><include file="parts/a.xml"/>{BODY}</mujoco>')
    (tmp_path / "parts" / "a.xml").write_text('<any><include file="deep/b.xml"/></any>')
    (inner / "b.xml").write_text('<any><include file="c.xml"/></any>')
    for folder, other in ((inner, 0.004), (tmp_path, 0.003)):  # the folder of the model comes first
        (folder / "c.xml").write_text(f'<any><option timestep="{other}"/></any>')
        assert mujoco.MjModel.from_xml_path(str(main)).opt.timestep == other
        require_sane_numbers(main)
        (folder / "c.xml").write_text('<any>\n<option timestep="nan"/></any>')
        error = refused(main)
        assert (Path(error.file), error.line, error.column) == (folder / "c.xml", 2, 9)
        (folder / "c.xml").write_text(f'<any><option timestep="{other}"/></any>')


def test_an_attached_model_is_checked_with_the_files_that_it_includes_itself(tmp_path: Path) -> None:
    (tmp_path / "child").mkdir()
    child = tmp_path / "child" / "child.xml"
    part = tmp_path / "child" / "part.xml"
    main = tmp_path / "main.xml"
    main.write_text(f'<mujoco><asset><model name="c" file="child/child.xml"/></asset>{BODY}</mujoco>')
    child.write_text(f'<mujoco><include file="part.xml"/>{BODY}</mujoco>')
    part.write_text('<any><compiler boundmass="nan"/></any>')
    assert Path(refused(main).file) == part


def test_files_that_include_each_other_are_read_once(tmp_path: Path) -> None:
    (tmp_path / "a.xml").write_text('<mujoco><include file="b.xml"/></mujoco>')
    (tmp_path / "b.xml").write_text('<any><include file="a.xml"/></any>')
    require_sane_numbers(tmp_path / "a.xml")


def test_a_model_that_attaches_itself_by_many_spellings_is_read_once(tmp_path: Path) -> None:
    names = ("one/../m.xml", "two/../m.xml")
    for name in names:
        (tmp_path / name[:3]).mkdir()
    models = "".join(f'<model name="{n}" file="{name}"/>' for n, name in enumerate(names))
    (tmp_path / "m.xml").write_text(f"<mujoco><asset>{models}</asset></mujoco>")
    require_sane_numbers(tmp_path / "m.xml")


@pytest.mark.parametrize("name", ["missing.xml", "", "x" * 5000, "a&#10;b", "/"])
def test_a_file_name_that_leads_nowhere_is_left_to_mujoco_or_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "m.xml").write_text(f'<mujoco><include file="{name}"/>{BODY}</mujoco>')
    if name in ("", "/"):
        assert "is a folder, not a file" in str(refused(tmp_path / "m.xml"))
    else:
        require_sane_numbers(tmp_path / "m.xml")


def test_entities_are_refused_before_they_are_expanded(tmp_path: Path) -> None:
    path = tmp_path / "m.xml"
    levels = "".join(f'<!ENTITY e{n + 1} "{f"&e{n};" * 10}">' for n in range(12))
    path.write_text(f'<!DOCTYPE m [<!ENTITY e0 "0">{levels}]>\n<mujoco><option timestep="&e12;"/></mujoco>')
    error = refused(path)
    assert error.line == 1 and "entity 'e0'" in error.message


@given(st.binary(max_size=200), st.integers(0, 200))
def test_no_bytes_end_in_another_error(
    tmp_path_factory: pytest.TempPathFactory, noise: bytes, at: int
) -> None:
    path = tmp_path_factory.getbasetemp() / "noise.xml"
    text = b'<mujoco><option timestep="0.002" gravity="0 0 -9.81"/><size memory="5M"/></mujoco>'
    path.write_bytes(text[:at] + noise + text[at:])
    with suppress(ConfigError):
        require_sane_numbers(path)


ODD_OPTIONS = [
    '<option timestep="nan"/>',
    '<option integrator="implicitfast" timestep="1e-300"/>',
    '<option timestep="1e300"/>',
    '<option timestep="-0.002"/>',
    '<option timestep="0"/>',
    '<option timestep="0.002 0.001"/>',
    '<option timestep=""/>',
    '<option gravity="0 0 inf"/>',
    '<compiler boundmass="nan"/>',
    '<size memory="1K"/>',
]


@pytest.mark.parametrize("option", ODD_OPTIONS)
def test_check_robot_refuses_it_with_file_line_and_column(
    tmp_path: Path, option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = robot_with(tmp_path, option)
    assert ctl(["check", "robot", str(path)]) == 1
    assert re.search(r"h24\.xml:\d+:\d+: (option|compiler|size) \w+: \"", capsys.readouterr().err)


@pytest.mark.parametrize("mode", ["sim", "mirror", "live"])
def test_no_mode_starts_with_it(tmp_path: Path, mode: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = robot_with(tmp_path, ODD_OPTIONS[0])
    arguments = ["--robot", str(path), "--mode", mode, "--socket", str(tmp_path), "--port", "main=/dev/null"]
    assert cli.main(arguments) != 0
    assert 'h24.xml:15:11: option timestep: "nan"' in capsys.readouterr().err


def test_a_virtual_robot_does_not_start_with_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = robot_with(tmp_path, ODD_OPTIONS[0])
    assert virtual(["--robot", str(path), "--link", str(tmp_path / "link")]) != 0
    assert 'h24.xml:15:11: option timestep: "nan"' in capsys.readouterr().err


@pytest.mark.parametrize("option", ['<option unknown="1"/>', '<option timestep="0.002" foo="x"/>'])
def test_an_unknown_mujoco_attribute_is_refused_without_a_traceback(
    tmp_path: Path, option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ctl(["check", "robot", str(robot_with(tmp_path, option))]) == 1
    said = "".join(capsys.readouterr())
    assert "unrecognized attribute" in said and "Traceback" not in said
