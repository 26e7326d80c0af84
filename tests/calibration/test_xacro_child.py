"""Expansion of xacro: what a file asks for beyond values and packages is refused, not carried out."""

import re
from pathlib import Path

import pytest
import xacro

from tests.support.model_files import copied_models, read_here
from twind.bounded_process import ProcessBounds
from twind.exceptions import InvalidInput
from twind_calibration.model_import import xacro_expansion
from twind_calibration.model_import.package_paths import PackagePaths
from twind_calibration.model_import.xacro_child import ConfinedXacro
from twind_calibration.model_import.xacro_expressions import evaluate

MASS = "${max(0.1, sizes['b'][0])}"  # an expression of bot.urdf.xacro, in line 11


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1 + 2 * x", 7),
        ("[i * 2 for i in range(3) if i]", [2, 4]),
        ("'a' if x > 2 else 'b'", "a"),
        ("' left '.strip().upper()", "LEFT"),
        ("limits.upper + limits['lower']", 1),
        ("'%.2f' % x", "3.00"),
        ("dict(a=1).get('a')", 1),
    ],
)
def test_expressions_that_describe_a_robot_are_evaluated(text: str, value: object) -> None:
    symbols = {"x": 3, "limits": xacro.YamlDictWrapper(upper=2, lower=-1), "range": range, "dict": dict}
    assert evaluate(text, symbols) == value


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('touch made')",
        "().__class__.__base__.__subclasses__()",
        "(lambda: ().__class__)()",
        "[each.__class__ for each in [1]]",
        "'{0.__class__}'.format(1)",
        "str.format('{0.__class__}', 1)",
        "'{0.real}'.format_map({})",
        "(i.gi_frame for i in [])",
        "[i for i in [1]].append(2)",
        "(x := 1)",
        "f'{x}'",
        "x.real",
        "str.mro()",
        "1 " + "+ 1" * 10_000,
    ],
)
def test_expressions_that_reach_into_python_are_refused(text: str) -> None:
    with pytest.raises(InvalidInput, match=r"not evaluated|at most 10000"):
        evaluate(text, {"x": 3, "str": str})


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("$(eval 1)", r":11:\d+: \$\(eval 1\) is not carried out: a file may not run or ask"),
        ("$(env HOME)", r":11:\d+: \$\(env HOME\) is not carried out"),
        ("$(cwd)", r":11:\d+: \$\(cwd\) is not carried out"),
        ("$(arg mass)", r":11:\d+: \$\(arg mass\): this argument has no value; give it: mass=VALUE"),
        ("$(find nowhere)", r":11:\d+: package 'nowhere' is in no folder above the file"),
        ("${(lambda: 1)()}", r":11:\d+: \$\{\(lambda: 1\)\(\)\}: Lambda is not evaluated"),
        ("${python.vars(1)}", r":11:\d+: .*vars"),
        (
            "${xacro.load_yaml('/etc/passwd')}",
            r":11:\d+: .*/etc/passwd is outside the packages of this model",
        ),
        ("${nothing}", r":11:\d+: xacro: name 'nothing' is not defined"),
    ],
)
def test_a_file_that_asks_for_more_is_refused_with_its_place(
    tmp_path: Path, text: str, expected: str
) -> None:
    assert re.match(".*bot.urdf.xacro" + expected, refusal_of(changed(tmp_path, MASS, text), tmp_path))


@pytest.mark.parametrize(
    ("file", "expected"),
    [
        ("/etc/passwd", r":7:\d+: /etc/passwd is outside the packages of this model; copy it there"),
        ("$(find bot_description)/../../secret.xacro", r":7:\d+: .*secret.xacro is outside the packages"),
        ("bot.urdf.xacro", r".*more than 40 levels deep; open the cycle"),
        ("gone.xacro", r":7:\d+: .*gone.xacro: No such file or directory"),
        ("bomb.xacro", r".*bomb.xacro:1:\d+: DOCTYPE and entities are not read"),
    ],
)
def test_an_include_stays_within_the_packages(tmp_path: Path, file: str, expected: str) -> None:
    path = changed(tmp_path, "$(find bot_description)/urdf/link.xacro", file)
    (path.parent / "bomb.xacro").write_text('<!DOCTYPE r [<!ENTITY a "a">]><robot>&a;</robot>')
    message = refusal_of(path, tmp_path)
    assert re.match(".*" + expected, message), message


def test_an_error_in_a_macro_names_the_file_of_the_macro(tmp_path: Path) -> None:
    path = changed(tmp_path, "${sizes['a'] * 10}", "-1")
    assert re.search(r"link.xacro:4:\d+: link 'base': mass -1 kg is below 0", refusal_of(path, tmp_path))


@pytest.mark.parametrize(
    ("text", "expected"),
    [("${9**9**9}", "takes more than 1 s"), ("${len('a' * 10**10)}", "memory|MemoryError")],
)
def test_time_and_memory_are_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, expected: str
) -> None:
    monkeypatch.setattr(xacro_expansion, "BOUNDS", ProcessBounds(seconds=1, memory=512, output=8))
    assert re.search(expected, refusal_of(changed(tmp_path, MASS, text), tmp_path))


@pytest.mark.parametrize(
    ("event", "details"),
    [
        ("open", ("/etc/passwd", "r", 0)),
        ("subprocess.Popen", ("true",)),
        ("os.system", ("true",)),
        ("socket.connect", ()),
        ("ctypes.dlopen", ()),
        ("os.remove", ()),
    ],
)
def test_the_audit_hook_permits_nothing_but_reading_of_packages(
    tmp_path: Path, event: str, details: tuple[object, ...]
) -> None:
    expansion = ConfinedXacro(tmp_path / "bot.xacro", PackagePaths(tmp_path, {}, {}))
    with pytest.raises(PermissionError):
        expansion.watch(event, details)
    expansion.watch("open", (str(tmp_path / "link.xacro"), "r", 0))
    with pytest.raises(PermissionError):
        expansion.watch("open", (str(tmp_path / "made"), "w", 0))


def changed(tmp_path: Path, old: str, new: str) -> Path:
    path = copied_models(tmp_path) / "bot_description" / "urdf" / "bot.urdf.xacro"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    return path


def refusal_of(path: Path, tmp_path: Path) -> str:
    with pytest.raises(InvalidInput) as caught:
        read_here(path, tmp_path / "new")
    message = str(caught.value)
    assert "\n" not in message
    return message
