"""Writes the doctor's table into a page: `python -m twind_calibration.doctor.page docs/troubleshooting.md`.

The page and the doctor say the same, for both have it from the table. A test compares them.
"""

import sys
from pathlib import Path

from twind_calibration.doctor import table

BEGIN, END = "<!-- from the doctor's table -->", "<!-- end of the doctor's table -->"


def rows() -> str:
    """The table in Markdown, one row a complaint, in the order of looking."""
    lines = ["| code | what is wrong | why it matters | do |", "|---|---|---|---|"]
    for row in table.complaints().values():
        remedy = f"{row.remedy}. **First: {row.caution}**" if row.caution else row.remedy
        cells = (f"{row.code} ({row.severity.value})", row.title, row.why, remedy)
        lines.append("| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |")
    return "\n".join(lines)


def written(text: str) -> str:
    """The page with its table as the doctor has it now. Raises ValueError: the page has no place for it."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"no {BEGIN} … {END} in the page")
    return f"{before}{BEGIN}\n\n{rows()}\n\n{END}{after}"


def main(arguments: list[str]) -> int:
    """Write the page named. Exit code 0."""
    path = Path(arguments[0])
    path.write_text(written(path.read_text(encoding="utf-8")), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
