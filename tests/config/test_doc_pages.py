"""Path of a page on this machine, the first of the possible folders that has it; rewriting of a page."""

from pathlib import Path

import pytest

from twind.config.doc_pages import CALIBRATION, page, renew_tables, rewrite_page


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


def test_a_page_is_rewritten_and_one_without_a_place_for_the_table_stays_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "page.md"
    path.write_text("°\n<!-- begin keys -->old<!-- end keys -->\n", encoding="utf-8")
    rewrite_page(path, lambda text: renew_tables(text, {"keys": "new"}))
    rewritten = path.read_text(encoding="utf-8")
    assert rewritten == "°\n<!-- begin keys -->\n\nnew\n\n<!-- end keys -->\n"
    with pytest.raises(ValueError, match="begin codes"):
        rewrite_page(path, lambda text: renew_tables(text, {"codes": "new"}))
    assert path.read_text(encoding="utf-8") == rewritten
