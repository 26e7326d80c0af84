"""Writer of the doctor's table: `python -m twind.doctor.write_checks_page docs/troubleshooting.md`.

Page and doctor use the same rows. A test compares them. Why a defect matters is printed by the doctor alone.
"""

import sys
from pathlib import Path

from twind.config.doc_pages import rewrite_page
from twind.doctor import check, runner

BEGIN = "<!-- from the doctor's table -->"
END = "<!-- end of the doctor's table -->"

# Cautions of several rows are in the page once, under these labels.
SHARED = {
    "support": check.SUPPORT,
    "supply off": check.UNPLUGGED,
    "other program": check.OTHER_MASTER,
    "permanent": check.ALONE,
    "zero changes": check.ZERO_MOVES,
    "firmware": check.FIRMWARE,
}


def labelled(caution: str) -> str:
    """Replace each shared part of a caution by its label."""
    for label, text in SHARED.items():
        caution = caution.replace(text, f"*{label}*")
    return caution


def table_lines() -> str:
    """Return both tables in Markdown: shared cautions, and one row per code in the order of the checks."""
    lines = ["|label|caution|", "|---|---|"]
    lines += [f"|*{label}*|{text}|" for label, text in SHARED.items()]
    lines += ["", "|code|defect|caution, remedy|", "|---|---|---|"]
    for row in runner.table().values():
        remedy = f"**{labelled(row.caution)}**; {row.remedy}" if row.caution else row.remedy
        cells = (row.code, row.title, remedy)
        lines.append("|" + "|".join(cell.replace("|", r"\|") for cell in cells) + "|")
    return "\n".join(lines)


def render_page(text: str) -> str:
    """Return the page with the present tables. Raises ValueError: the page has no place for them."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"no {BEGIN} … {END} in the page")
    return f"{before}{BEGIN}\n\n{table_lines()}\n\n{END}{after}"


if __name__ == "__main__":
    rewrite_page(Path(sys.argv[1]), render_page)
