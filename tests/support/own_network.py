"""A network of its own for a process: loopback and one interface `d0` with multicast and a default route."""

import shutil
import subprocess
from pathlib import Path

import pytest

_MISSING = 77  # exit code: the namespace has no veth
_SCRIPT = f"""
ip link set lo up && ip link add d0 type veth peer name d1 || exit {_MISSING}
ip addr add 10.9.9.1/24 dev d0 || exit {_MISSING}
sysctl -qw net.ipv6.conf.all.disable_ipv6=1
ip link set d0 up && ip link set d1 up && ip route add default dev d0 || exit {_MISSING}
exec "$@"
"""


def run(
    *command: str, seconds: float, environment: dict[str, str] | None = None, folder: Path | None = None
) -> "subprocess.CompletedProcess[str]":
    """The command, run in that network to its end. Skips the test where the machine gives none."""
    if shutil.which("unshare") is None or shutil.which("ip") is None:
        pytest.skip("needs unshare and ip: a network namespace")
    done = subprocess.run(
        ["unshare", "-rn", "sh", "-c", _SCRIPT, "sh", *command],
        capture_output=True,
        text=True,
        timeout=seconds,
        env=environment,
        cwd=folder,
    )
    if done.returncode and ("unshare" in done.stderr or done.returncode == _MISSING):
        pytest.skip(f"this machine gives no network namespace: {done.stderr.strip()}")
    return done
