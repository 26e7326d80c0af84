"""The check of a release notices a wrong digest, bill of materials and licence, by name."""

import json
import os
import shutil
import subprocess
import zipfile
from pathlib import Path

import pytest

from tests.support.doc_pages_text import ROOT
from tools import check_release as release

WHEELS = (
    "numpy-2.4.6-cp311-cp311-linux.whl",
    "numpy-2.4.6-cp312-cp312-linux.whl",
    "PyYAML-6.0-py3-none-any.whl",
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A release of one file and its bill of materials, with a folder of the wheels that a package brings."""
    (tmp_path / "wheels").mkdir()
    for name in WHEELS:
        (tmp_path / "wheels" / name).write_text(name)
    made = tmp_path / "dist"
    made.mkdir()
    components = [{"name": "numpy", "version": "2.4.6"}, {"name": "pyyaml", "version": "6.0"}]
    (made / "twind_1.cdx.json").write_text(json.dumps({"components": components}))
    (made / "twind.whl").write_text("a wheel")
    sums = [f"{release.digest(each)}  {each.name}\n" for each in sorted(made.iterdir())]
    (made / "SHA256SUMS").write_text("".join(sums))
    return made


def test_a_sound_release_passes(folder: Path) -> None:
    release.check_digests(folder)
    assert release.check_materials(folder, [folder.parent / "wheels"]) == 2


@pytest.mark.parametrize("change", ["another byte", "another file", "a file less"])
def test_a_file_that_is_not_the_listed_one_is_noticed(folder: Path, change: str) -> None:
    if change == "another byte":
        (folder / "twind.whl").write_text("a wheeL")
    elif change == "another file":
        (folder / "more.whl").write_text("")
    else:
        (folder / "twind.whl").unlink()
    with pytest.raises(release.ReleaseFault, match="SHA256SUMS"):
        release.check_digests(folder)


@pytest.mark.parametrize("name", ["numpy-2.5.0-cp313-cp313-linux.whl", "more-1-py3-none-any.whl"])
def test_a_wheel_that_the_bill_of_materials_does_not_name_is_noticed(folder: Path, name: str) -> None:
    (folder.parent / "wheels" / name).write_text("")
    with pytest.raises(release.ReleaseFault, match=r"(numpy==2\.5\.0|more==1)"):
        release.check_materials(folder, [folder.parent / "wheels"])


def licensed(folder: Path, stated: str, listed: object) -> None:
    """A wheel whose metadata state that, in a folder of its own, and a bill of materials that lists this."""
    (folder / "licensed").mkdir()
    with zipfile.ZipFile(folder / "licensed/numpy-2.4.6-py3-none-any.whl", "w") as archive:
        archive.writestr("numpy-2.4.6.dist-info/METADATA", f"Metadata-Version: 2.4\nName: numpy\n{stated}\n")
    component = {"name": "numpy", "version": "2.4.6", "licenses": listed}
    (folder / "dist/twind_1.cdx.json").write_text(json.dumps({"components": [component]}))
    release.check_licences(folder / "dist", [folder / "licensed"])


@pytest.mark.parametrize(
    ("stated", "listed"),
    [
        ("License-Expression: MIT", [{"license": {"id": "MIT"}}]),
        ("License-Expression: MIT AND 0BSD", [{"expression": "MIT AND 0BSD"}]),
        ("Classifier: License :: OSI Approved :: BSD License", [{"license": {"name": "BSD"}}]),
    ],
)
def test_a_licence_as_its_author_states_it_passes(folder: Path, stated: str, listed: object) -> None:
    licensed(folder.parent, stated, listed)


@pytest.mark.parametrize(
    ("stated", "listed", "fault"),
    [
        ("License-Expression: MIT", [{"license": {"id": "BSD-3-Clause"}}], "not MIT"),
        ("License: BSD", [], "no licence of numpy"),
        ("Summary: arrays", [{"license": {"id": "MIT"}}], "states no licence"),
    ],
)
def test_a_wrong_or_missing_licence_is_noticed(folder: Path, stated: str, listed: object, fault: str) -> None:
    with pytest.raises(release.ReleaseFault, match=fault):
        licensed(folder.parent, stated, listed)


def test_what_fails_is_named_with_its_words() -> None:
    with pytest.raises(release.ReleaseFault, match=r"exit code 3\n.*why"):
        release.run("sh", "-c", "echo why >&2; exit 3")


def test_each_interpreter_that_is_found_is_one_that_twind_serves() -> None:
    found = list(release.interpreters())
    assert found and len(found) == len(set(found))
    for each in found:
        assert Path(each).name in release.NAMES


def test_a_package_for_a_processor_without_wheels_is_refused(tmp_path: Path) -> None:
    given = os.environ | {"ARCHITECTURE": "armhf"}
    done = subprocess.run([ROOT / "packaging/deb.sh", tmp_path], env=given, capture_output=True, text=True)
    assert done.returncode == 1
    if shutil.which("dpkg-deb"):
        assert "ARCHITECTURE=armhf: packages are made for amd64 and arm64" in done.stderr
