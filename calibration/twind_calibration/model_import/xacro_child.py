"""Process that expands one xacro file: `python -m twind_calibration.model_import.xacro_child`.

The package `xacro` evaluates Python in `${...}` and checks names of the outermost code only: a lambda or
`str.format` reaches all of Python. Here expressions are checked node by node (`xacro_expressions.py`), and
`$(eval ...)` and `$(env ...)` are refused. An audit hook permits this process to read files of the model's
packages and nothing else: no process, no network, no written file.
"""

import json
import os
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.dom import expatbuilder
from xml.parsers.expat import ErrorString, ExpatError

import xacro
import yaml  # noqa: F401 - `load_yaml` finds it loaded

from twind.bounded_process import read_request, refusal
from twind.exceptions import InvalidInput
from twind_calibration.model_import.imported_model import import_refused
from twind_calibration.model_import.package_paths import PackagePaths
from twind_calibration.model_import.xacro_expressions import evaluate
from twind_calibration.model_import.xml_tree import MAX_BYTES, PLACE, read_bytes

# Audit events of Python itself and of looking for files; all others are refused.
HARMLESS = {"import", "compile", "exec", "marshal.loads", "code.__new__", "sys._getframe", "builtins.id"}
LOOKING = {"os.listdir", "os.scandir", "glob.glob", "glob.glob/2", "object.__getattr__", "object.__setattr__"}
HIDDEN = ("vars", "type")  # functions of `python.` that reach into Python
MAX_LEVELS = 40  # files that include each other


class ConfinedXacro:
    """One expansion: takes the place of functions of the package `xacro` that reach outside."""

    def __init__(self, file: Path, paths: PackagePaths) -> None:
        self.sources: list[str] = []
        self._file = str(file)
        self._paths = paths
        self._roots = [os.path.realpath(root) for root in (*paths.roots(), file.parent)]
        self._python = [os.path.realpath(root) for root in (sys.prefix, sys.base_prefix)]
        self._failed = ""  # text that could not be evaluated
        self._place = ""  # of the last element
        self._eval_all: Any = xacro.eval_all

    def install(self) -> None:
        """Replace functions of `xacro`, then allow this process nothing but reading."""
        xacro.safe_eval = self.evaluate
        xacro.eval_extension = self.substitute
        xacro.eval_all = self.eval_all
        xacro.parse = self.parse
        for name in HIDDEN:
            dict.pop(xacro._global_symbols["python"], name, None)
        sys.addaudithook(self.watch)

    def expand(self, arguments: Mapping[str, str]) -> str:
        """Text of the expanded file. Raises InvalidInput."""
        try:
            return str(xacro.process_file(self._file, mappings=dict(arguments), verbosity=0).toxml())
        except RecursionError:
            raise import_refused(
                "macros or values refer to each other without end; open it", where=self._file
            ) from None
        except Exception as error:  # noqa: BLE001 - xacro raises what its expressions raise
            refused = self._cause(error)
            if refused is None:
                reason = f"xacro: {str(error) or type(error).__name__}"
                refused = import_refused(reason, where=self._where(str(error)))
            raise import_refused(refused.reason, where=refused.where or self._where(refused.reason)) from None

    def evaluate(self, text: str, symbols: Any, _locals: object = None) -> Any:
        """Value of one `${...}`."""
        try:
            return evaluate(text, symbols)
        except MemoryError:
            raise import_refused(
                f"${{{text[:80]}}} needs too much memory; make it smaller", where=self._file
            ) from None
        except Exception:
            self._failed = self._failed or text
            raise

    def substitute(self, text: str) -> str:
        """Value of one `$(...)`."""
        words = text[2:-1].split()
        known = xacro.substitution_args_context["arg"]
        match words:
            case ["arg", name] if name in known:
                return str(known[name])
            case ["find", package]:
                folder = self._paths.find(package, self._where(text))
                self._roots.append(os.path.realpath(folder))
                return str(folder)
            case ["optenv", _, *default]:
                return " ".join(default)
            case ["dirname"]:
                return str(Path(xacro.filestack[-1]).absolute().parent)
        self._failed = text
        if words[:1] == ["arg"]:
            remedy = f"give it: {words[1]}=VALUE" if len(words) == 2 else "name one"
            raise import_refused(f"{text[:80]}: this argument has no value; {remedy}")
        allowed = "$(arg), $(find), $(dirname) and ${...} are; write those"
        raise import_refused(f"{text[:80]} is not carried out: a file may not run or ask for this; {allowed}")

    def eval_all(self, node: Any, macros: Any, symbols: Any) -> None:
        """Expand below one element."""
        self._place = node.getAttribute(PLACE) or self._place
        self._eval_all(node, macros, symbols)

    def parse(self, _text: None, filename: str) -> Any:
        """Document of a file, its elements with their places."""
        where = self._where(os.path.basename(filename)) if self.sources else ""
        if len(xacro.filestack) > MAX_LEVELS:
            raise import_refused(
                f"{filename} is included more than {MAX_LEVELS} levels deep; open the cycle", where=where
            )
        if not self._is_within(filename, self._roots):
            remedy = "copy it there, or name its package"
            raise import_refused(f"{filename} is outside the packages of this model; {remedy}", where=where)
        data = read_bytes(Path(filename), MAX_BYTES, where)
        if filename not in self.sources:
            self.sources.append(filename)
        builder = _PlacingBuilder(filename, self.sources.index(filename))
        try:
            return builder.parseString(data)
        except ExpatError as error:
            reason = f"no well-formed XML: {ErrorString(error.code)}; correct it here"
            raise import_refused(reason, where=f"{filename}:{error.lineno}:{error.offset + 1}") from None

    def watch(self, event: str, details: tuple[Any, ...]) -> None:
        """Audit hook. Raises PermissionError for all but reading of permitted files."""
        if event in HARMLESS or event in LOOKING:
            return
        if event != "open":
            raise PermissionError(f"{event} is not carried out for a model file")
        path, mode = details[0], details[1]
        if isinstance(path, int):
            return
        writes = mode is not None and set(mode) & set("wax+")
        if writes or not self._is_within(os.fsdecode(path), [*self._roots, *self._python]):
            raise PermissionError(f"{os.fsdecode(path)} is outside the packages of this model")

    def _is_within(self, path: str, roots: list[str]) -> bool:
        real = os.path.realpath(path)
        return any(real == root or real.startswith(root.rstrip("/") + "/") for root in roots)

    def _cause(self, error: BaseException) -> InvalidInput | None:
        """Refusal that xacro wrapped in its own error."""
        for _ in range(100):
            if isinstance(error, InvalidInput):
                return error
            inner = getattr(error, "exc", None) or error.__cause__ or error.__context__
            if not isinstance(inner, BaseException):
                return None
            error = inner
        return None

    def _where(self, reason: str) -> str:
        """Place of the text that failed, in the file that is being read first."""
        current = [name for name in xacro.filestack or [] if name in self.sources][-1:]
        named = re.search(r"xacro:[\w.]+", reason)
        for text in (self._failed, reason, named[0] if named else ""):
            for name in [*current, *self.sources] if text else ():
                lines = Path(name).read_text(encoding="utf-8", errors="replace").splitlines()
                for number, line in enumerate(lines, 1):
                    if text in line:
                        return f"{name}:{number}:{line.index(text) + 1}"
        source, _, place = self._place.partition(":")
        return f"{self.sources[int(source)]}:{place}" if place else self._file


class _PlacingBuilder(expatbuilder.ExpatBuilderNS):
    """DOM whose elements, but those of xacro, have their place as an attribute. Refuses DOCTYPE."""

    def __init__(self, file: str, number: int) -> None:
        super().__init__()
        self._source = file
        self._number = number

    def start_element_handler(self, name: str, attributes: list[str]) -> None:
        """Add one element."""
        super().start_element_handler(name, attributes)
        node: Any = self.curNode
        if not node.tagName.startswith("xacro:"):
            node.setAttribute(PLACE, f"{self._number}:{self._line()}")

    def start_doctype_decl_handler(self, *_declaration: object) -> None:
        """Refuse a DOCTYPE, which could declare entities."""
        reason = "DOCTYPE and entities are not read; remove the declaration"
        raise import_refused(reason, where=f"{self._source}:{self._line()}")

    def _line(self) -> str:
        parser = self.getParser()
        return f"{parser.CurrentLineNumber}:{parser.CurrentColumnNumber + 1}"


def main() -> None:
    """Answer one request."""
    request = read_request()
    file = Path(request["file"])
    packages = {name: Path(folder) for name, folder in request["packages"].items()}
    expansion = ConfinedXacro(file, PackagePaths(file.parent, packages, request["environment"]))
    expansion.install()
    try:
        answer: object = {"xml": expansion.expand(request["arguments"]), "sources": expansion.sources}
    except InvalidInput as error:
        answer = refusal(error)
    sys.stdout.write(json.dumps(answer))


if __name__ == "__main__":
    main()
