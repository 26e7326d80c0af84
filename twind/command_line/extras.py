"""Commands that add an extra of twind to the Python environment of this process.

They name a folder and an environment, never the name `twind`: on PyPI that is another project. In a clone,
`make` adds the extra: pip without `--editable` would replace the clone by a copy.
"""

import json
import sys
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from shlex import quote
from urllib.parse import unquote, urlsplit

from twind.version import DISTRIBUTION


def how_to_add(extra: str) -> str:
    """The shell command for the environment that this process runs in, such as `make -C CLONE extras …`."""
    return command(extra, Path(sys.prefix), sys.executable, clone())


def command(extra: str, prefix: Path, python: str, source: Path | None) -> str:
    """The command for the environment `prefix` with its interpreter `python`.

    `source`: the clone that twind was installed from; None: unknown.
    """
    installed = prefix.parent.parent / "extras"  # packaging/install.sh names those of a service there
    if installed.is_file():
        names = [*filter(None, installed.read_text().strip().split(",")), extra]
        return f"in the clone of twind, sudo make install EXTRAS={','.join(names)}"
    if source is None:
        return f"in the clone of twind, {quote(python)} -m pip install '.[{extra}]'"
    if prefix == source / ".venv":
        return f"make -C {quote(str(source))} extras EXTRAS={extra}"
    pins = f"--constraint {quote(str(source / 'constraints.txt'))} "
    return f"{quote(python)} -m pip install {pins}{quote(f'{source}[{extra}]')}"


def clone() -> Path | None:
    """The folder that twind was installed from, as pip recorded it; None: a wheel, or it is gone."""
    try:
        recorded = distribution(DISTRIBUTION).read_text("direct_url.json")
    except PackageNotFoundError:
        return None
    folder = Path(unquote(urlsplit(json.loads(recorded)["url"]).path)) if recorded else None
    return folder if folder is not None and (folder / "pyproject.toml").is_file() else None
