"""The campaign takes up where it ended, counts no failure as passed, and its page shows the totals."""

from pathlib import Path

import pytest

from tests.proof.campaign import __main__ as driver
from tests.proof.campaign import totals as t
from tests.proof.campaign.subjects import SUBJECTS
from tests.support.doc_pages_text import PROOF

WIRE = "fuzz-wire"
GOOD = "wire: 500 inputs of seed 28 in 1 s, 0 broke, next FIRST=500"
BAD = "wire: 301 inputs of seed 28 in 1 s, 1 broke, next FIRST=801"


def total(subject: str = WIRE) -> t.SubjectTotal:
    return t.SubjectTotal("0", subject, 0)


def test_a_piece_that_passed_is_added_and_the_next_begins_behind_it() -> None:
    seen = total()
    assert driver.add(seen, SUBJECTS[WIRE], 500, (0, GOOD))
    assert (seen.passed, seen.failed, seen.next, seen.open) == (500, 0, 500, [])


def test_what_each_robot_lived_is_added_by_its_name() -> None:
    lived = '{"robot": "koch",\n "hours": 0.25}\npassed: 0.25 h'
    seen = total("soak")
    for run in [(0, lived), (0, lived), (1, lived)]:
        driver.add(seen, SUBJECTS["soak"], 0.25, run)
    assert seen.parts == {"koch": 0.5}


def test_a_failure_is_counted_with_its_command_and_never_as_passed() -> None:
    seen = total()
    driver.add(seen, SUBJECTS[WIRE], 500, (0, GOOD))
    assert not driver.add(seen, SUBJECTS[WIRE], 500, (1, BAD))
    assert (seen.passed, seen.failed, seen.next) == (800, 1, 801)
    assert seen.open == ["tests.proof.fuzz --what wire -n 500 --seed 28 --first 500"]


@pytest.mark.parametrize("subject", SUBJECTS)
@pytest.mark.parametrize("run", [(-9, ""), (1, "Traceback"), (0, "no figures")])
def test_a_harness_that_dies_or_says_nothing_has_failed(subject: str, run: tuple[int, str]) -> None:
    seen = total(subject)
    assert not driver.add(seen, SUBJECTS[subject], 20, run)
    assert (seen.passed, seen.failed, len(seen.open)) == (0, 1, 1)
    assert seen.next > 0, "the next run would only fail again"


def test_a_harness_that_hangs_is_ended() -> None:
    code, _ = driver.output_of("timeit -s 'import time' 'time.sleep(60)'", 0.2)
    assert code != 0


def test_a_new_version_begins_where_the_last_one_ended(tmp_path: Path) -> None:
    seen = [t.SubjectTotal("0", WIRE, 700, passed=700)]
    t.write(seen, tmp_path / "totals.json")
    kept = t.read(tmp_path / "totals.json")
    new = t.of(kept, WIRE, "1")
    assert (new.passed, new.next) == (0, 700)
    assert kept == [*seen, new]


def test_a_failure_that_passes_when_repeated_is_mended(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = [t.SubjectTotal("0", WIRE, 9, failed=2, open=["one", "other"])]
    monkeypatch.setattr(driver, "output_of", lambda command, longest: (int(command == "one"), ""))
    monkeypatch.setattr(driver, "saved", lambda totals: None)
    assert driver.again(seen) == 1
    assert (seen[0].failed, seen[0].open, seen[0].mended) == (2, ["one"], ["other"])


def test_the_page_shows_the_totals() -> None:
    assert t.page_with_totals(PROOF, t.read()) == PROOF, "python -m tests.proof.campaign.totals"
