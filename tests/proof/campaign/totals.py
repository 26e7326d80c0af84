"""Totals of the campaign by version and subject, in `totals.json`, and their table in docs/proof.md."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from tests.proof.campaign.subjects import SUBJECTS
from twind.config.doc_pages import renew_tables, rewrite_page
from twind.version import __version__

TOTALS = Path(__file__).with_name("totals.json")
PAGE = Path(__file__).parents[3] / "docs" / "proof.md"


@dataclass
class SubjectTotal:
    """Counts of one version in one subject."""

    version: str
    subject: str
    next: int  # first number, or seed, of the next piece
    passed: float = 0.0
    failed: float = 0.0  # in all, mended ones too
    seconds: float = 0.0  # that the pieces took
    commit: str = ""  # of the last piece
    date: str = ""
    open: list[str] = field(default_factory=list)  # commands whose failure is not mended
    mended: list[str] = field(default_factory=list)  # ... that pass by now
    parts: dict[str, float] = field(default_factory=dict)  # of what passed, by name


def read(path: Path = TOTALS) -> list[SubjectTotal]:
    """All totals; none where the file is not there yet."""
    return [SubjectTotal(**each) for each in json.loads(path.read_text())] if path.exists() else []


def write(totals: Sequence[SubjectTotal], path: Path = TOTALS) -> None:
    """Replace the file, a line for each total."""
    lines = ",\n".join(json.dumps(asdict(each)) for each in totals)
    new = path.with_suffix(".new")
    new.write_text(f"[\n{lines}\n]\n")
    new.replace(path)


def of(totals: list[SubjectTotal], subject: str, version: str = __version__) -> SubjectTotal:
    """The total of a subject; a new version begins where the last one ended."""
    own = [each for each in totals if each.subject == subject]
    for each in own:
        if each.version == version:
            return each
    totals.append(SubjectTotal(version, subject, max((each.next for each in own), default=0)))
    return totals[-1]


def hours_left(total: SubjectTotal) -> float | None:
    """Hours to the goal at the pace so far; None where nothing has passed yet."""
    if not total.passed:
        return None
    left = max(0.0, SUBJECTS[total.subject].goal - total.passed)
    return left * total.seconds / total.passed / 3600.0


def page_with_totals(page: str, totals: Sequence[SubjectTotal]) -> str:
    """The page with the table of this version's totals."""
    lines = [
        "| subject | passed | failed, of these open | goal | hours to the goal |",
        "|---|---|---|---|---|",
    ]
    for total in (each for each in totals if each.version == __version__):
        subject = SUBJECTS[total.subject]
        hours = hours_left(total)
        left = "?" if hours is None else f"{hours:.1f}"
        cells = (f"{total.passed:,.10g} {subject.unit}", f"{total.failed:g}, {len(total.open)}")
        lines.append(f"| `{total.subject}` | {' | '.join(cells)} | {subject.goal:,.10g} | {left} |")
    return renew_tables(page, {"totals": "\n".join(lines)})


if __name__ == "__main__":
    rewrite_page(PAGE, lambda page: page_with_totals(page, read()))
