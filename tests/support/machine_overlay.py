"""A throw-away copy of this machine to install into: an overlay of `/` in namespaces of its own, no network.

Nothing that is written there outlives it. No service manager runs there; one boots in
`tests/support/systemd/`.
"""

import os
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

ENTER = [
    "unshare",
    "--mount",
    "--propagation",
    "private",
    "--pid",
    "--fork",
    "--kill-child",
    "--net",
    "sh",
    "-euc",
]
# $1: a folder for the layers; $2: what to run. At the end what it left is listed, directories aside.
# The layer `hidden` takes out what a twind on the machine itself wrote: a device 0/0 hides a name of the
# layers below (kernel documentation, overlayfs, "whiteouts").
SCRIPT = """
mount -t tmpfs -o size=1g,mode=755 tmpfs "$1"
mkdir -p "$1/upper" "$1/work" "$1/top" "$1/hidden/etc" "$1/hidden/var/lib"
mknod "$1/hidden/etc/twind" c 0 0
mknod "$1/hidden/var/lib/twind" c 0 0
mount -t overlay overlay -o lowerdir="$1/hidden":/,upperdir="$1/upper",workdir="$1/work" "$1/top"
mount -t proc proc "$1/top/proc"
mount --rbind /dev "$1/top/dev"
mount -t tmpfs -o mode=755 tmpfs "$1/top/run"
status=0
chroot "$1/top" sh -euc "$2" || status=$?
echo "== left"
cd "$1/upper" && find . ! -type d | sed 's|^[.]||'
exit $status
"""
PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"


@dataclass(frozen=True)
class Ran:
    """Output of a script, and the paths that it changed."""

    output: str
    left: frozenset[str]


def run(
    folder: Path, script: str, environment: Mapping[str, str] | None = None, *, fails: bool = False
) -> Ran:
    """A shell script in the copy; it must succeed, or fail where that is the claim."""
    state = folder / "overlay"
    state.mkdir(exist_ok=True)
    given = {"PATH": PATH, "HOME": "/root", "LANG": "C.UTF-8"} | dict(environment or {})
    command = [*ENTER, SCRIPT, "sh", str(state), script]
    done = subprocess.run(
        command, env=given, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False
    )
    assert (done.returncode != 0) == fails, done.stdout
    output, listed, left = done.stdout.partition("== left\n")
    assert listed, output
    return Ran(output, frozenset(left.split()))


@cache
def _refusal() -> str:
    if os.geteuid() != 0:
        return "needs root"
    missing = [program for program in ("unshare", "mount", "chroot") if shutil.which(program) is None]
    if missing:
        return f"no {missing[0]} here"
    folder = subprocess.run(["mktemp", "-d"], capture_output=True, text=True, check=True).stdout.strip()
    try:
        (Path(folder) / "overlay").mkdir()
        command = [*ENTER, SCRIPT, "sh", f"{folder}/overlay", "true"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        return done.stderr.strip() or "not allowed" if done.returncode else ""
    finally:
        shutil.rmtree(folder)


def require() -> None:
    """Skip where this machine allows no such copy, with its words."""
    reason = _refusal()
    if reason:
        pytest.skip(f"no overlay of / in a namespace: {reason}")
