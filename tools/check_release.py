"""Check of what `make release` built: `check_release.py FOLDER [--python INTERPRETER] [--quick]`.

The digests are those of the files. The bill of materials names exactly the wheels of each package, with the
licences that they state. Wheels and packages are built again, with the same bytes (`--quick` leaves this
out). In an empty environment of each interpreter the wheel is installed from the package's wheels alone,
without an index; it starts, and leaves nothing when it is uninstalled.
"""

import argparse
import email
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path

HOME = Path(__file__).parents[1]
NAMES = [f"python3.{minor}" for minor in range(11, 15)]
SECONDS = 30.0  # for a daemon to start on a busy machine
OWN = "twind_robot"


class ReleaseFault(Exception):
    """A file that was built is not as it should be."""


def require(true: bool, fault: str) -> None:
    """Raise ReleaseFault unless it is true."""
    if not true:
        raise ReleaseFault(fault)


def run(*command: object, **variables: str) -> str:
    """Output of a command with these variables. Raises ReleaseFault with its words."""
    words = [str(word) for word in command]
    done = subprocess.run(words, env=os.environ | variables, capture_output=True, text=True, check=False)
    require(
        done.returncode == 0, f"{' '.join(words)}: exit code {done.returncode}\n{done.stdout}{done.stderr}"
    )
    return done.stdout


def one(folder: Path, pattern: str) -> Path:
    """The only file of that pattern. Raises ReleaseFault."""
    found = sorted(folder.glob(pattern))
    require(len(found) == 1, f"{folder}: one {pattern} expected, found {[each.name for each in found]}")
    return found[0]


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def interpreters() -> Iterator[str]:
    """Interpreters of this machine that twind serves: on PATH, or beside ours (version managers)."""
    beside = Path(sys.base_prefix).resolve().parent
    for name in NAMES:
        there = [str(each) for each in sorted(beside.glob(f"*/bin/{name}"))]
        found = shutil.which(name) or next(iter(there), None)
        if (
            found
            and subprocess.run([found, "-c", "import venv"], capture_output=True, check=False).returncode == 0
        ):
            yield found
        elif there:
            yield there[-1]


def normal(name: str) -> str:
    """Name of a distribution, as indexes compare names."""
    return re.sub(r"[-_.]+", "-", name).lower()


def wheels(package: Path, into: Path) -> Path:
    """The wheels of a package."""
    run("dpkg-deb", "--extract", package, into)
    return into / "usr/lib/twind/wheels"


def listed(folder: Path) -> set[str]:
    """NAME==VERSION of the wheels in a folder."""
    parts = [wheel.name.split("-") for wheel in folder.glob("*.whl")]
    return {f"{normal(name)}=={version}" for name, version, *_ in parts}


def check_digests(folder: Path) -> None:
    """Every file is listed with its digest."""
    lines = [line.split("  ") for line in (folder / "SHA256SUMS").read_text().splitlines()]
    files = {path.name: digest(path) for path in folder.iterdir() if path.name != "SHA256SUMS"}
    require(files == {name: sum_ for sum_, name in lines}, f"{folder}: SHA256SUMS does not list its files")


def check_materials(folder: Path, of_packages: Sequence[Path]) -> int:
    """The bill of materials lists what each package brings; how many distributions."""
    read = json.loads(one(folder, "*.cdx.json").read_text())
    named = {f"{normal(each['name'])}=={each['version']}" for each in read["components"]}
    for wheel_folder in of_packages:
        require(named == listed(wheel_folder), f"bill of materials: {named ^ listed(wheel_folder)} differ")
    return len(named)


def stated_licence(wheel: Path) -> str | None:
    """SPDX expression of a wheel, "" for a licence in other words, None where its metadata state none."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (each for each in archive.namelist() if re.fullmatch(r"[^/]+\.dist-info/METADATA", each))
        read = email.message_from_bytes(archive.read(name))
    words = [read["License"] or "", *(read.get_all("Classifier") or [])]
    other = words[0] or any(word.startswith("License ::") for word in words[1:])
    return str(read["License-Expression"]) if read["License-Expression"] else "" if other else None


def check_licences(folder: Path, of_packages: Sequence[Path]) -> None:
    """The bill of materials has the licence of each wheel, as its author states it."""
    read = json.loads(one(folder, "*.cdx.json").read_text())
    named: dict[str, set[str]] = {}
    for component in read["components"]:
        of = named.setdefault(normal(component["name"]), set())
        for each in component.get("licenses", []):
            licence = each.get("license", {})
            of |= {each.get("expression", ""), licence.get("id", ""), licence.get("name", "")} - {""}
    for wheel in (wheel for each in of_packages for wheel in each.glob("*.whl")):
        name, stated = normal(wheel.name.split("-")[0]), stated_licence(wheel)
        require(stated is not None, f"{wheel.name} states no licence")
        require(bool(named[name]), f"bill of materials: no licence of {name}")
        require(
            not stated or stated in named[name], f"bill of materials: {name} is {named[name]}, not {stated}"
        )


def check_again(folder: Path, packages: dict[Path, Path], work: Path) -> None:
    """Wheels and packages built anew have the same bytes."""
    install = HOME / "packaging/install.sh"
    stamp = json.loads(one(folder, "*.cdx.json").read_text())["metadata"]["timestamp"]
    epoch = f"{datetime.fromisoformat(stamp).timestamp():.0f}"
    for pattern, sources in ((f"{OWN}-*.whl", HOME), ("lerobot_*.whl", HOME / "integrations/lerobot")):
        run(install, "own", work, sources, SOURCE_DATE_EPOCH=epoch)
        wheel = one(folder, pattern)
        require(digest(work / wheel.name) == digest(wheel), f"{wheel}: built again it is another file")
    for package, of in packages.items():
        architecture = package.stem.rsplit("_", 1)[1]
        tags = {tag for wheel in of.glob("*.whl") for tag in re.findall(r"-cp3(\d+)-cp3\d+-", wheel.name)}
        pythons = " ".join(f"3.{tag}" for tag in tags)
        again = work / architecture
        variables = {"ARCHITECTURE": architecture, "WHEELS": str(of), "PYTHONS": pythons}
        run(HOME / "packaging/deb.sh", again, **variables, SOURCE_DATE_EPOCH=epoch)
        require(digest(again / package.name) == digest(package), f"{package}: built again it is another file")


def check_start(interpreter: str, wheel: Path, of: Path, work: Path) -> str:
    """Installed in an empty environment and started; the version that it prints."""
    environment = work / "environment"
    run(interpreter, "-m", "venv", "--clear", environment)
    pip = [environment / "bin/python", "-m", "pip", "--isolated", "--disable-pip-version-check", "--quiet"]
    run(*pip, "install", "--no-index", "--find-links", of, wheel)
    run(*pip, "check")
    bare = {"PATH": f"{environment}/bin:/usr/bin:/bin", "HOME": str(work), "LANG": "C.UTF-8"}
    sockets = work / "sockets"
    version = run(
        "env", "-i", *(f"{key}={value}" for key, value in bare.items()), "twind", "--version"
    ).strip()
    with (work / "log").open("wb") as log:
        command = [environment / "bin/twind", "--mode", "sim", "--socket", sockets]
        daemon = subprocess.Popen(command, env=bare, stdout=log, stderr=log)
    ask = [environment / "bin/twindctl", "--socket", sockets, "status"]
    until = time.monotonic() + SECONDS
    try:
        while subprocess.run(ask, env=bare, capture_output=True, check=False).returncode:
            alive = daemon.poll() is None and time.monotonic() < until
            require(alive, f"{interpreter}: no daemon\n{(work / 'log').read_text()}")
            time.sleep(0.2)
        time.sleep(1.0)
        require(daemon.poll() is None, f"{interpreter}: the daemon ended\n{(work / 'log').read_text()}")
    finally:
        daemon.send_signal(signal.SIGTERM)
        code = daemon.wait(SECONDS)
    require(code == 0, f"{interpreter}: the daemon ended with {code}\n{(work / 'log').read_text()}")
    run(*pip, "uninstall", "--yes", OWN)
    left = [str(path) for path in (*environment.rglob("*twind*"), *sockets.rglob("*"))]
    require(not left, f"{interpreter}: left behind: {left}")
    return version


def check(folder: Path, pythons: Sequence[str], again: bool, work: Path) -> None:
    """All of it, each result printed. Raises ReleaseFault."""
    check_digests(folder)
    packages = {each: wheels(each, work / each.stem) for each in sorted(folder.glob("*.deb"))}
    require(bool(packages), f"{folder}: no package; `make release` builds it")
    print(f"{check_materials(folder, list(packages.values()))} distributions in {len(packages)} packages")
    check_licences(folder, list(packages.values()))
    if again:
        check_again(folder, packages, work / "again")
        print("built again: the same bytes")
    own = run("dpkg", "--print-architecture").strip()
    (of,) = (each for package, each in packages.items() if package.stem.endswith(f"_{own}"))
    for interpreter in pythons:
        said = check_start(interpreter, one(folder, f"{OWN}-*.whl"), of, work)
        print(f"{run(interpreter, '-V').strip()}: {said}: installed and started", flush=True)
    missing = [name for name in NAMES if not any(each.endswith(name) for each in pythons)]
    print(f"not on this machine: {', '.join(missing) or 'none'}")


def main(arguments: Sequence[str]) -> int:
    """Exit code 0: all is as it should be."""
    parser = argparse.ArgumentParser(prog="check_release", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--python", action="append", help="interpreters; those of this machine")
    parser.add_argument("--quick", action="store_true", help="build nothing again")
    asked = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="twind-release-") as work:
        try:
            check(asked.folder, asked.python or list(interpreters()), not asked.quick, Path(work))
        except ReleaseFault as fault:
            print(fault, file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
