"""Path of a page on this machine: the first of the possible folders that has it."""

from pathlib import Path

from twind.config.doc_pages import CALIBRATION, page


def test_the_first_folder_that_holds_a_page_is_named(tmp_path: Path) -> None:
    made = tmp_path / "local"
    packaged = tmp_path / "share"
    (packaged / CALIBRATION).parent.mkdir(parents=True)
    (packaged / CALIBRATION).touch()
    assert page(CALIBRATION, (made, packaged)) == str(packaged / CALIBRATION)
    (made / CALIBRATION).parent.mkdir(parents=True)
    (made / CALIBRATION).touch()
    assert page(CALIBRATION, (made, packaged)) == str(made / CALIBRATION)


def test_a_page_found_in_no_folder_gets_no_invented_path(tmp_path: Path) -> None:
    (tmp_path / CALIBRATION).mkdir(parents=True)  # a folder of that name is no page
    assert page(CALIBRATION, (tmp_path,)) == "calibration/README.md of twind's sources"


def test_pages_are_searched_where_the_installer_puts_them(tmp_path: Path) -> None:
    said = (Path(__file__).parents[2] / "packaging/install.sh").read_text()
    assert "SHARE=${SHARE:-/usr/local/share}" in said
    assert '"$SHARE/doc/twind/$each"' in said
    assert page("pyproject.toml").endswith("/pyproject.toml")
