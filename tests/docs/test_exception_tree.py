"""The exception classes of the program are those of the tree in `twind.exceptions`, and at most 20."""

import builtins
import re
from collections.abc import Iterator
from pathlib import Path

from twind import exceptions

HOME = Path(__file__).parents[2]
PACKAGES = ("twind", "drivers/twind_drivers", "calibration/twind_calibration")
MOST = 21
STEP = 4  # characters of one level in the drawn tree


CLASS = re.compile(r"^ *class (\w+)\(([^)]*)\)", re.MULTILINE)


def _class_bases() -> Iterator[tuple[str, tuple[str, ...]]]:
    """Classes with bases, from the text: a syntax tree of all files takes a second."""
    for package in PACKAGES:
        for path in (HOME / package).rglob("*.py"):
            for name, bases in CLASS.findall(path.read_text(encoding="utf-8")):
                yield name, tuple(base.strip().rpartition(".")[2] for base in bases.split(","))


def _exception_classes() -> dict[str, str]:
    """Own exception classes with their first base."""
    bases = {name: each for name, each in _class_bases() if each}
    builtin = {
        name
        for name, each in vars(builtins).items()
        if isinstance(each, type) and issubclass(each, BaseException)
    }
    found: set[str] = set()
    while new := {name for name, each in bases.items() if {*each} & (builtin | found)} - found:
        found |= new
    return {name: bases[name][0] for name in found}


def _drawn_classes() -> dict[str, str]:
    """Classes of the drawn tree with the class above each."""
    lines = [line for line in (exceptions.__doc__ or "").splitlines() if "── " in line]
    above = ["TwindError"]
    found = {"TwindError": "Exception"}
    for line in lines:
        depth = line.index("── ") // STEP
        name = line.partition("── ")[2].split()[0]
        found[name] = above[depth - 1]
        above[depth:] = [name]
    return found


def test_exception_classes_match_drawn_tree_and_stay_within_limit() -> None:
    found = _exception_classes()
    assert found == _drawn_classes()
    assert len(found) <= MOST
