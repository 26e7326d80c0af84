"""The pages that the tests hold to the truth, and how they are read."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    [
        ROOT / "README.md",
        *(ROOT / "docs").glob("*.md"),
        *(ROOT / room / "README.md" for room in ("drivers", "calibration", "systemd", "packaging/metrics")),
    ]
)
NOT_ON_THE_SITE = [ROOT / "CONTRIBUTING.md", ROOT / "SECURITY.md"]  # read where the sources are
README = (ROOT / "README.md").read_text()
SAFETY = (ROOT / "docs" / "safety.md").read_text()
REASON_CODES = (ROOT / "docs" / "reason-codes.md").read_text()
PROOF = (ROOT / "docs" / "proof.md").read_text()
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def name(page: Path) -> str:
    """For the names of tests."""
    return str(page.relative_to(ROOT))


def fenced(text: str, language: str) -> list[str]:
    """Bodies of the fenced blocks of one language."""
    return [body for kind, body in FENCE.findall(text) if kind == language]


def table(text: str, *heading: str) -> list[list[str]]:
    """Rows of the table with that heading; a `\\|` inside a cell is no border."""
    lines = text.splitlines()
    start = lines.index("| " + " | ".join(heading) + " |") + 2
    rows = []
    for line in lines[start:]:
        if not line.startswith("|"):
            break
        rows.append([cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]])
    assert rows and all(len(row) == len(heading) for row in rows), rows
    return rows
