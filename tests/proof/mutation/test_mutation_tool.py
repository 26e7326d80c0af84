"""The tool of `make mutate`: what it changes, what it leaves alone; its ledger names what is there."""

import ast
import re
import subprocess
import sys
from importlib.util import find_spec

from tests.proof.mutation.__main__ import ledger
from tests.proof.mutation.mutated_code import cases_of
from tests.proof.mutation.operators import mutants
from tests.proof.mutation.rooms import HOME, ROOMS


def words(source: str) -> set[str]:
    return {mutant.words for mutant in mutants(ast.parse(source))}


def test_comparisons_numbers_and_members_are_changed() -> None:
    assert words("def f(x):\n    return x < 2") == {
        "return x < 2 -> return None",
        "x < 2 -> x <= 2",
        "x < 2 -> x >= 2",
        "2 -> 3",
        "2 -> 1",
    }
    assert words("a = RobotState.FAULT") == {"RobotState.FAULT -> RobotState.CONNECTED"}
    assert words("a = not b and min(c)") >= {
        "not b and min(c) -> not b or min(c)",
        "not b -> b",
        "min -> max",
    }


def test_words_types_and_slips_of_the_programmer_are_left_alone() -> None:
    assert words('def f(a: int | None) -> int | None:\n    """Docs."""\n    assert a > 1') == set()
    assert words("from a import b") == set()
    assert "True -> False" not in words("zip(a, b, strict=True)")
    assert words("a = f'{1 + 1} of 3'") == set()


def test_a_change_goes_into_the_tree_at_its_place() -> None:
    tree = ast.parse("def f(x):\n    y = 1\n    return x - y")
    [sum_] = [mutant for mutant in mutants(tree) if mutant.words == "x - y -> x + y"]
    sum_.switch()
    assert "x + y" in ast.unparse(tree)
    assert (sum_.scope, sum_.lines) == ("f", (3, 3))


def test_every_survivor_that_is_listed_is_there_once() -> None:
    modules = [module for room in ROOMS for module in room.modules]
    names = {case.name for module in modules for case in cases_of(module)}
    assert set(ledger()) <= names
    assert all((HOME / test).is_file() for room in ROOMS for test in room.tests)
    for reason in ledger().values():
        assert reason.startswith(("equivalent: ", "accepted: "))


def test_a_mutant_of_a_room_is_judged_in_a_session_of_its_own() -> None:
    """`homing`: its tests import helpers of `tests.support`, and so must be importable a second time."""
    command = [sys.executable, "-m", "tests.proof.mutation", "homing", "--sample", "1", "--brief", "--anew"]
    run = subprocess.run(command, cwd=HOME, capture_output=True, text=True, timeout=120, check=False)
    assert "1 of 1 mutants killed" in run.stdout, run.stdout + run.stderr


def test_every_module_that_make_runs_exists() -> None:
    modules = set(re.findall(r"python -m ([a-z_.]+)", (HOME / "Makefile").read_text()))
    assert modules >= {"bench", "tests.proof.mutation"}
    assert [module for module in modules if find_spec(module) is None] == []
