"""One line on the machine that took the figures, without names of hosts, people or folders."""

import os
import platform
import re
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = ("numpy", "mujoco-core", "msgspec")


def describe() -> str:
    """Processor, cores, kernel, Python, packages, load."""
    text = Path("/proc/cpuinfo").read_text()
    model = re.search(r"^model name\s*: (.+)$", text, re.MULTILINE)
    kind = "virtual machine, " if re.search(r"^flags.*\bhypervisor\b", text, re.MULTILINE) else ""
    kernel = re.match(r"[\d.]+", platform.release())
    preempt = next((word for word in platform.version().split() if word.startswith("PREEMPT")), "no PREEMPT")
    packages = ", ".join(f"{name} {_version(name)}" for name in PACKAGES)
    return (
        f"{datetime.now(UTC):%Y-%m-%d}: {kind}{len(os.sched_getaffinity(0))} cores"
        f" ({model[1] if model else platform.machine()}), Linux {kernel[0] if kernel else '?'} {preempt},"
        f" Python {platform.python_version()}, {packages}; load average at the end"
        f" {os.getloadavg()[0]:.1f}"
    )


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "?"
