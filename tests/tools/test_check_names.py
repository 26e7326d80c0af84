"""The check of names fails for an offender of each kind, and for an allowed entry without an offender."""

from pathlib import Path

import pytest

from tools import check_names

CLEAN = '"""A module."""\n'


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A tree without an offender."""
    for package in check_names.PACKAGES:
        (tmp_path / package / "room").mkdir(parents=True)
        (tmp_path / package / "__init__.py").write_text(CLEAN)
        (tmp_path / package / "room" / "__init__.py").write_text(CLEAN)
    for folder in ("tools", "tests/room", "tests/support"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / check_names.WORDS).write_text("told\nreins\n")
    (tmp_path / check_names.ALLOWED).write_text("# the offenders that are left\n")
    return tmp_path


def plant(tree: Path, path: str, text: str) -> None:
    (tree / path).write_text(CLEAN + text)


def test_a_tree_without_an_offender_passes(tree: Path) -> None:
    plant(tree, "twind/lease.py", 'class Lease:\n    """A right to command."""\n')
    assert check_names.offenders(tree) == set()
    assert check_names.main([str(tree)]) == 0


PLANTED = {
    "class-name-twice": (
        {"twind/a.py": "class Line: ...\n", "bench/b.py": "class Line: ...\n"},
        "class Line: bench/b.py, twind/a.py",
    ),
    "module-name-twice": (
        {"twind/verb.py": "", "twind/room/verb.py": ""},
        "module verb: twind/room/verb.py, twind/verb.py",
    ),
    "docstring-relative-clause": (
        {"twind/a.py": 'def reply():\n    """Of one press: the replies."""\n'},
        "docstring twind/a.py::reply",
    ),
    "docstring-what-is": (
        {"twind/a.py": 'class Verdict:\n    """What is known of a joint."""\n'},
        "docstring twind/a.py::Verdict",
    ),
    "docstring-whether": (
        {"twind/a.py": 'def reply():\n    """Whether a reply came."""\n'},
        "docstring twind/a.py::reply",
    ),
    "docstring-of-a-test": (
        {"tests/room/test_lease.py": 'def test_lease():\n    """When the lease ends."""\n'},
        "docstring tests/room/test_lease.py::test_lease",
    ),
    "test-word": (
        {"tests/room/test_lease.py": "def test_the_client_is_told(): ...\n"},
        "retired-word tests/room/test_lease.py::test_the_client_is_told",
    ),
    "parameter-word": (
        {"twind/a.py": "def reply(joint, *, told=0): ...\n"},
        "retired-word twind/a.py::reply(told)",
    ),
    "class-word": ({"twind/a.py": "class StateTold: ...\n"}, "retired-word twind/a.py::StateTold"),
    "module-word": ({"twind/reins.py": ""}, "retired-word twind/reins.py"),
    "function-word": (
        {"twind/a.py": "class Client:\n    def _told_of(self): ...\n"},
        "retired-word twind/a.py::Client._told_of",
    ),
    "test-import": (
        {"tests/room/test_lease.py": "from tests.room.test_gate import Rig\n"},
        "test-import tests/room/test_lease.py: tests.room.test_gate.Rig",
    ),
    "test-import-in-function": (
        {"tests/support/rig.py": "def lease():\n    from tests.room import test_gate\n"},
        "test-import tests/support/rig.py: tests.room.test_gate",
    ),
    "private-attribute": (
        {"tests/room/test_lease.py": "def test_lease(lease):\n    assert lease._holder is None\n"},
        "private-attribute tests/room/test_lease.py: _holder",
    ),
}


@pytest.mark.parametrize(("files", "offender"), PLANTED.values(), ids=PLANTED)
def test_a_planted_offender_fails_the_check_until_it_is_allowed(
    tree: Path, files: dict[str, str], offender: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for path, text in files.items():
        plant(tree, path, text)
    assert check_names.offenders(tree) == {offender}
    assert check_names.main([str(tree)]) == 1
    assert offender in capsys.readouterr().out
    (tree / check_names.ALLOWED).write_text(f"{offender}\n")
    assert check_names.main([str(tree)]) == 0


def test_a_stricter_rule_lists_all_its_offenders_at_once(tree: Path) -> None:
    plant(tree, "twind/a.py", "def told(): ...\n")
    plant(tree, "twind/b.py", "def reins(): ...\n")
    assert check_names.main(["--allow", str(tree)]) == 0
    listed = (tree / check_names.ALLOWED).read_text().splitlines()
    assert listed[1:] == ["retired-word twind/a.py::told", "retired-word twind/b.py::reins"]


def test_a_test_may_use_what_it_defines_and_documented_names_with_an_underscore(tree: Path) -> None:
    text = """
import os
class Rig(Base):
    def __init__(self):
        self._time = 0.0
    def step(self):
        return self._base + super()._step()
def test_rig(rig, row):
    assert rig._time == row._replace(time=0.0).time or os._exit(1)
"""
    plant(tree, "tests/room/test_rig.py", text)
    assert check_names.offenders(tree) == set()


def test_modules_of_different_packages_may_have_the_same_name(tree: Path) -> None:
    plant(tree, "twind/budget.py", "")
    plant(tree, "drivers/twind_drivers/budget.py", "")
    assert check_names.offenders(tree) == set()


def test_an_allowed_entry_without_an_offender_fails_until_it_is_removed(tree: Path) -> None:
    (tree / check_names.ALLOWED).write_text("# left\nretired-word twind/gone.py\n")
    assert check_names.main([str(tree)]) == 1
    assert check_names.main(["--shrink", str(tree)]) == 0
    assert (tree / check_names.ALLOWED).read_text() == "# left\n"
