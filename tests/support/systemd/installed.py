"""twind as it is installed on the machine of the tests: units, users and folders of this repository, and its
code at /opt/twind, where a hardened unit can read it.

The environment that runs the tests is shown there by read-only binds: nothing is copied, downloaded or built.
"""

import os
import subprocess
import sys
import sysconfig
from importlib.metadata import entry_points
from pathlib import Path

REPOSITORY = Path(__file__).parents[3]
OPT = "/opt/twind"
PYTHON = f"{OPT}/python"  # where the interpreter's own installation is seen
SOURCE = f"{OPT}/source"
PACKAGES = f"{OPT}/packages"
PEERS = f"{OPT}/tests"  # programs of the tests that run there: /tmp, where a clone may be, is another one
ROOMS = ("twind", "drivers/twind_drivers", "calibration/twind_calibration")
# People of the machine: one of each group, and one of none.
PEOPLE = """\
u pilot - "may command" -
m pilot twind-operator
u watcher - "may look" -
m watcher twind-observe
u stranger - "may nothing" -
"""


def own_python() -> bool:
    """The interpreter stands in a folder of its own, which may be one that hardened units cannot see."""
    return Path(sys.base_prefix) not in (Path("/usr"), Path("/"))


def binds() -> dict[str, str]:
    """Read-only mounts: place -> source."""
    shown = {f"{SOURCE}/{room}": str(REPOSITORY / room) for room in ROOMS}
    shown[PEERS] = str(REPOSITORY / "tests")
    shown[PACKAGES] = sysconfig.get_path("purelib")
    if own_python():
        shown[PYTHON] = sys.base_prefix
    return shown


def lay(tree: Path) -> None:
    """The files of it."""
    _environment(tree)
    files(tree)
    people = tree / "etc/sysusers.d/people.conf"
    people.parent.mkdir(parents=True, exist_ok=True)
    people.write_text(PEOPLE)


def files(tree: Path) -> None:
    """Units, users, folders and rules, laid there as `make install` lays them."""
    places = {"DESTDIR": str(tree), "LIB": "/usr/lib", "SHARE": "/usr/share", "BIN": "/usr/bin"}
    install = [str(REPOSITORY / "packaging/install.sh"), "files"]
    subprocess.run(["sh", *install], env={**os.environ, **places}, check=True)


def _environment(tree: Path) -> None:
    """A virtual environment at /opt/twind whose packages are those of the tests."""
    home = Path(tree, OPT.lstrip("/"))
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    base = Path(PYTHON if own_python() else sys.base_prefix)
    packages = home / "lib" / version / "site-packages"
    packages.mkdir(parents=True)
    sources = [SOURCE, *sorted({str(Path(SOURCE, room).parent) for room in ROOMS if "/" in room})]
    (packages / "shown.pth").write_text("\n".join([*sources, PACKAGES]) + "\n")
    (home / "pyvenv.cfg").write_text(f"home = {base}/bin\ninclude-system-site-packages = false\n")
    (home / "bin").mkdir()
    (home / "bin/python").symlink_to(base / "bin" / version)
    for script in entry_points(group="console_scripts"):
        if script.module.split(".")[0] == "twind":
            _script(home / "bin" / script.name, script.module, script.attr)
    if own_python():  # its binary may name the library's folder by the place that it was built for
        for library in Path(sys.base_prefix, "lib").glob("libpython*.so*"):
            # The machine's own of that name would be found first, and be of another release.
            others = Path("/usr/lib").glob(f"*/{library.name}")
            for place in (Path("/usr/lib", library.name), *others):
                link = Path(tree, str(place).lstrip("/"))
                link.parent.mkdir(parents=True, exist_ok=True)
                link.symlink_to(f"{PYTHON}/lib/{library.name}")


def _script(path: Path, module: str, attribute: str) -> None:
    lines = [
        f"#!{OPT}/bin/python",
        "import sys",
        f"from {module} import {attribute}",
        f"sys.exit({attribute}())",
    ]
    path.write_text("\n".join(lines) + "\n")
    path.chmod(0o755)
