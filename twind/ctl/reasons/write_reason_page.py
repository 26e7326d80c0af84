"""Writer of reason code tables: `python -m twind.ctl.reasons.write_reason_page docs/reason-codes.md`."""

import sys
from collections.abc import Mapping
from pathlib import Path

from twind.config.doc_pages import renew_tables, rewrite_page
from twind.ctl.reasons.reason_text import ReasonText
from twind.ctl.reasons.request_codes import REQUEST_CODES
from twind.ctl.reasons.runtime_codes import RUNTIME_CODES
from twind.robot.finding import ReasonCode

TABLES = {"request codes": REQUEST_CODES, "runtime codes": RUNTIME_CODES}


def rows(codes: Mapping[ReasonCode, ReasonText]) -> str:
    """One table in Markdown, in alphabetical order."""
    lines = ["| code | effect | cause | remedy |", "|---|---|---|---|"]
    for code in sorted(codes):
        text = codes[code]
        lines.append(f"| `{code}` | {text.effect} | {text.cause} | {text.remedy} |")
    return "\n".join(lines)


def page_with_tables(page: str) -> str:
    """The page with both tables as the code has them. Raises ValueError without a place for one."""
    return renew_tables(page, {name: rows(codes) for name, codes in TABLES.items()})


if __name__ == "__main__":
    rewrite_page(Path(sys.argv[1]), page_with_tables)
