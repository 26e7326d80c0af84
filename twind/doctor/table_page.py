"""Writer of the doctor's table: `python -m twind.doctor.table_page docs/troubleshooting.md`.

Page and doctor use the same rows. A test compares them. Why a defect matters is printed by the doctor alone.
"""

import sys
from pathlib import Path

from twind.doctor import cautions, check_table

BEGIN = "<!-- from the doctor's table -->"
END = "<!-- end of the doctor's table -->"

# Cautions of several rows stand once in the page, under these labels.
SHARED = {
    "support": cautions.SUPPORT,
    "supply off": cautions.UNPLUGGED,
    "other program": cautions.OTHER_MASTER,
    "permanent": cautions.ALONE,
    "zero changes": cautions.ZERO_MOVES,
    "meaning changes": cautions.MEANING,
    "limit": cautions.RAISED,
    "reboot": cautions.REBOOT,
    "rated voltage": cautions.RATED,
    "firmware": cautions.FIRMWARE,
    "bit rate": cautions.BIT_RATE,
}


def labelled(caution: str) -> str:
    """The caution with each shared part replaced by its label."""
    for label, text in SHARED.items():
        caution = caution.replace(text, f"*{label}*")
    return caution


def rows() -> str:
    """Both tables in Markdown: shared cautions, and one row per complaint in the order of the checks."""
    lines = ["| label | caution |", "|---|---|"]
    lines += [f"| *{label}* | {text} |" for label, text in SHARED.items()]
    lines += ["", "| code | defect | caution, remedy |", "|---|---|---|"]
    for row in check_table.complaints().values():
        remedy = f"**{labelled(row.caution)}**; {row.remedy}" if row.caution else row.remedy
        cells = (f"{row.code} ({row.severity.value})", row.title, remedy)
        lines.append("| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |")
    return "\n".join(lines)


def render_page(text: str) -> str:
    """The page with its tables of today. Raises ValueError where the page has no place for them."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"no {BEGIN} … {END} in the page")
    return f"{before}{BEGIN}\n\n{rows()}\n\n{END}{after}"


def main(arguments: list[str]) -> int:
    """Write the page named. Exit code 0."""
    path = Path(arguments[0])
    path.write_text(render_page(path.read_text(encoding="utf-8")), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
