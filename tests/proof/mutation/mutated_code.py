"""Mutated code: the mutants of a module, in the living function or in a fresh import of everything."""

import ast
import importlib.abc
import importlib.util
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from types import CodeType, ModuleType
from typing import Any

from tests.proof.mutation.operators import Mutant, mutants
from tests.proof.mutation.rooms import HOME, importable

OURS = ("twind", "twind_drivers", "twind_calibration")
TOOL = "tests.proof.mutation"


@dataclass
class Case:
    """A mutant with its name and its fate: a test's name, "timeout", or None while it lives."""

    module: str
    tree: ast.Module  # the module's; the child that tries the mutant changes it
    mutant: Mutant
    name: str
    killer: str | None = None
    covered: bool = False


class ChangedModule(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Loads the mutated module in the place of the true one."""

    def __init__(self, case: Case) -> None:
        self._case = case
        self._name = importable(case.module)

    def find_spec(self, name: str, path: Any, target: ModuleType | None = None) -> Any:
        if name != self._name:
            return None
        return importlib.util.spec_from_loader(name, self, origin=str(HOME / self._case.module))

    def exec_module(self, module: ModuleType) -> None:
        module.__file__ = str(HOME / self._case.module)
        exec(compiled(self._case), module.__dict__)


def cases_of(module: str) -> list[Case]:
    """Every mutant of a module under a name that outlives moved lines."""
    source = (HOME / module).read_text()
    rows = source.splitlines()
    seen = dict[str, int]()
    cases = []
    tree = ast.parse(source)
    for mutant in mutants(tree):
        name = f"{module}::{mutant.scope}::{rows[mutant.line - 1].strip()}::{mutant.words}"
        seen[name] = seen.get(name, 0) + 1
        name += f" #{seen[name]}" if seen[name] > 1 else ""
        cases.append(Case(module, tree, mutant, name))
    return cases


def compiled(case: Case) -> CodeType:
    """Compile the mutant. It changes the tree, so it is only for a process that needs the tree no more."""
    case.mutant.switch()
    return compile(case.tree, str(HOME / case.module), "exec")


def living(case: Case) -> Any:
    """The outermost function around the mutant, as it was imported; None where there is none."""
    try:
        return reduce(getattr, case.mutant.scope.split("."), sys.modules[importable(case.module)])
    except (KeyError, AttributeError):
        return None


def transplant(case: Case) -> None:
    """Puts the mutated code into the function that lives. Raises ValueError where it does not fit."""
    codes = [
        each for each in _codes(compiled(case), case.mutant.scope) if each.co_firstlineno <= case.mutant.line
    ]
    code = codes[-1] if codes else None  # getter and setter of a property have one name
    found = living(case)
    if isinstance(found, property):
        found = next(each for each in (found.fget, found.fset) if _begins_at(each, code))
    if hasattr(found, "cache_clear"):
        found.cache_clear()
    while hasattr(found, "__wrapped__"):
        found = found.__wrapped__
    found = getattr(found, "__func__", found)
    if code is None or not hasattr(found, "__code__"):
        raise ValueError(case.name)
    found.__code__ = code


def _begins_at(function: Any, code: CodeType | None) -> bool:
    return (
        function is not None and code is not None and function.__code__.co_firstlineno == code.co_firstlineno
    )


def _codes(code: CodeType, name: str) -> Iterator[CodeType]:
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            if constant.co_qualname == name:
                yield constant
            yield from _codes(constant, name)


def forget() -> None:
    """Remove all imported modules of the program and of its tests, except this tool and its packages.

    A package that stays loses the attribute too: `from package import module` takes it before it imports.
    """
    tests = str(HOME / "tests")
    for name, module in list(sys.modules.items()):
        top = name.partition(".")[0]
        ours = top in OURS or top == "tests" or (getattr(module, "__file__", None) or "").startswith(tests)
        if ours and name != "__main__" and not TOOL.startswith(name) and not name.startswith(TOOL):
            del sys.modules[name]
            package, _, last = name.rpartition(".")
            if package in sys.modules:
                vars(sys.modules[package]).pop(last, None)
