"""Check of names, docstrings and tests: `python tools/check_names.py [--shrink | --allow] [ROOT]`.

`make lint` runs it. Class names are unique in the program, module names in each package. A docstring begins
with a noun or a verb. Retired words stand in no name of a class, module, function or parameter. No file of
the tests imports a test module or uses a private attribute that it does not define.
`tools/allowed_names.txt` lists the offenders that are left. An entry without an offender fails the check too,
so the list can only shrink. `--allow` writes the list anew, for a rule that becomes stricter.
"""

import argparse
import ast
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

HOME = Path(__file__).parents[1]
ALLOWED = Path("tools/allowed_names.txt")
WORDS = Path("tools/retired_words.txt")
PACKAGES = ("twind", "drivers/twind_drivers", "calibration/twind_calibration", "bench")
TESTS = "tests"
REMEDIES = {
    "test-import": "move what both need to tests/support",
    "private-attribute": "assert what is visible from outside, or give the object a narrow public property",
}
# Attributes with an underscore that their documentation declares public.
PUBLIC = {"_replace", "_fields", "_asdict", "_exit", "_getframe"}
SAME_IN_EACH_PACKAGE = {"__init__", "__main__"}
RELATIVE_CLAUSE = re.compile(r"(Of|Who|Whom|Whose|What|Which|Where|When|How|Whether)\b")
WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")

Definition = ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def definitions(node: ast.AST, within: str = "") -> Iterator[tuple[str, Definition]]:
    """Classes and functions below a node, with their qualified names."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, Definition):
            name = f"{within}.{child.name}" if within else child.name
            yield name, child
            yield from definitions(child, name)
        else:
            yield from definitions(child, within)


def words(name: str) -> set[str]:
    """Lower-case words of a name in CamelCase or snake_case."""
    return {word.lower() for word in WORD.findall(name)}


def duplicates(kind: str, places: dict[str, list[str]]) -> Iterator[str]:
    """One offender per name that stands in several places."""
    for name, paths in sorted(places.items()):
        if len(paths) > 1:
            yield f"{kind} {name}: {', '.join(sorted(paths))}"


def parameters(arguments: ast.arguments) -> list[str]:
    """Names of all parameters of a function."""
    rest = [each for each in (arguments.vararg, arguments.kwarg) if each]
    return [each.arg for each in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs, *rest)]


def imported_modules(node: ast.AST) -> list[str]:
    """Names that an import statement makes available, with their packages."""
    if isinstance(node, ast.ImportFrom):
        return [f"{node.module}.{alias.name}" for alias in node.names]
    return [alias.name for alias in node.names] if isinstance(node, ast.Import) else []


def private_attributes(tree: ast.AST) -> set[str]:
    """Private attributes that the file uses of other objects and does not define itself."""
    used: set[str] = set()
    own = set(PUBLIC)
    for node in ast.walk(tree):
        if isinstance(node, Definition):
            own.add(node.name)
        elif isinstance(node, ast.Attribute) and node.attr.startswith("_") and not node.attr.endswith("__"):
            if ast.unparse(node.value) not in {"self", "cls", "super()"}:
                used.add(node.attr)
            elif isinstance(node.ctx, ast.Store):
                own.add(node.attr)
    return used - own


def offenders_in_tests(root: Path) -> Iterator[str]:
    """Imports of test modules and uses of private attributes in the tests of the tree at `root`."""
    for path in sorted((root / TESTS).rglob("*.py")):
        place = path.relative_to(root).as_posix()
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            for module in imported_modules(node):
                parts = module.split(".")
                if parts[0] == TESTS and any(part.startswith("test_") for part in parts):
                    yield f"test-import {place}: {module}"
        for attribute in private_attributes(tree):
            yield f"private-attribute {place}: {attribute}"


def offenders_in_names(place: str, tree: ast.Module, retired: set[str]) -> Iterator[str]:
    """Retired words in the names of a module at `place` and relative clauses in its docstrings."""
    if words(Path(place).stem) & retired:
        yield f"retired-word {place}"
    if RELATIVE_CLAUSE.match(ast.get_docstring(tree) or ""):
        yield f"docstring {place}"
    for name, node in definitions(tree):
        arguments = [] if isinstance(node, ast.ClassDef) else parameters(node.args)
        yield from (
            f"retired-word {place}::{name}({argument})" for argument in arguments if words(argument) & retired
        )
        if words(node.name) & retired:
            yield f"retired-word {place}::{name}"
        if RELATIVE_CLAUSE.match(ast.get_docstring(node) or ""):
            yield f"docstring {place}::{name}"


def offenders(root: Path) -> set[str]:
    """All offenders of the tree at `root`, each as `KIND PLACE`."""
    retired = set((root / WORDS).read_text().split())
    found = set(offenders_in_tests(root))
    classes: dict[str, list[str]] = defaultdict(list)
    for folder in (*PACKAGES, TESTS):
        modules: dict[str, list[str]] = defaultdict(list)
        for path in sorted((root / folder).rglob("*.py")):
            place = path.relative_to(root).as_posix()
            tree = ast.parse(path.read_text(encoding="utf-8"))
            found.update(offenders_in_names(place, tree, retired))
            if folder != TESTS:
                modules[path.stem].append(place)
                for name, node in definitions(tree):
                    if isinstance(node, ast.ClassDef) and "." not in name:
                        classes[name].append(place)
        found.update(
            duplicates("module", {n: p for n, p in modules.items() if n not in SAME_IN_EACH_PACKAGE})
        )
    found.update(duplicates("class", classes))
    return found


def main(arguments: list[str] | None = None) -> int:
    """Print what is wrong. Returns the exit code: 1 where something is."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("root", type=Path, nargs="?", default=HOME)
    parser.add_argument("--shrink", action="store_true", help="remove the entries whose offender is gone")
    parser.add_argument("--allow", action="store_true", help="list all offenders as allowed")
    options = parser.parse_args(arguments)
    found = offenders(options.root)
    listed = (options.root / ALLOWED).read_text().splitlines()
    if options.allow:
        listed = [line for line in listed if line.startswith("#")] + sorted(found)
        (options.root / ALLOWED).write_text("\n".join(listed) + "\n")
    allowed = {line for line in listed if line and not line.startswith("#")}
    gone = allowed - found
    if options.shrink and gone:
        (options.root / ALLOWED).write_text("\n".join(line for line in listed if line not in gone) + "\n")
        gone = set()
    for each in sorted(found - allowed):
        print(
            f"{each}: {REMEDIES.get(each.split()[0], 'rename or reword it; words: tools/retired_words.txt')}"
        )
    for each in sorted(gone):
        print(f"{each}: gone; remove it from {ALLOWED}: python tools/check_names.py --shrink")
    return int(bool(found - allowed or gone))


if __name__ == "__main__":
    sys.exit(main())
