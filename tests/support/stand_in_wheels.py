"""Wheels of a stand-in for twind-robot."""

import zipfile
from collections.abc import Mapping
from pathlib import Path


def wheel(folder: Path, version: str, *, code: str = "def main():\n    print('here')\n") -> Path:
    """A folder with a small wheel called twind-robot that brings a command, and one of its extra."""
    more = "Provides-Extra: more\nRequires-Dist: twind-more; extra == 'more'\n"
    commands = {"entry_points.txt": "[console_scripts]\ntwind = twind_stand_in:main\n"}
    _pack(folder, "twind_robot", version, {"twind_stand_in.py": code}, more, commands)
    _pack(folder, "twind_more", "1.0.0", {"twind_more.py": ""}, "", {})
    return folder


def _pack(
    folder: Path, name: str, version: str, modules: Mapping[str, str], more: str, about: Mapping[str, str]
) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    info = f"{name}-{version}.dist-info"
    files = {
        **modules,
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n{more}",
        f"{info}/WHEEL": "Wheel-Version: 1.0\nGenerator: tests\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        **{f"{info}/{file}": text for file, text in about.items()},
    }
    files[f"{info}/RECORD"] = "".join(f"{file},,\n" for file in [*files, f"{info}/RECORD"])
    with zipfile.ZipFile(folder / f"{name}-{version}-py3-none-any.whl", "w") as archive:
        for file, text in files.items():
            archive.writestr(zipfile.ZipInfo(file, (2026, 1, 1, 0, 0, 0)), text)
