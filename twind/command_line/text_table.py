"""Tables as plain text, and numbers in them. Standard library only."""

from collections.abc import Collection, Sequence


def align_columns(rows: Sequence[Sequence[str]], left: Collection[int]) -> list[str]:
    """Lines of a table. Columns whose numbers are in `left` are left-aligned, the others right-aligned."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return [
        "  ".join(
            cell.ljust(width) if place in left else cell.rjust(width)
            for place, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


def fixed_number(value: float | None, digits: int, missing: str) -> str:
    """A number with so many digits after the point, never -0.000; `missing` for None."""
    return missing if value is None else f"{round(value, digits) + 0.0:.{digits}f}"
