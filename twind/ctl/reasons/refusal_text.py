"""A refused call in one line, with its remedy."""

from twind.client import CallError, Refused
from twind.ctl.reasons import remedy


def refusal_text(error: CallError) -> tuple[str, str]:
    """Return the code of a refusal, and its message with the remedy."""
    findings = error.findings if isinstance(error, Refused) else ()
    if not findings:
        return error.name, str(error)
    first = findings[0]
    more = f" (and {len(findings) - 1} more)" if len(findings) > 1 else ""
    return str(first["code"]), f"{first['message']}{more}. Remedy: {remedy(str(first['code']))}"
