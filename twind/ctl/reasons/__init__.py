"""Effect, cause and remedy of every reason code, for `twindctl` and docs/reason-codes.md."""

from collections.abc import Mapping

from twind.ctl.reasons.reason_text import ReasonText
from twind.ctl.reasons.request_codes import REQUEST_CODES
from twind.ctl.reasons.runtime_codes import RUNTIME_CODES
from twind.robot.finding import ReasonCode

REASONS: Mapping[ReasonCode, ReasonText] = {**REQUEST_CODES, **RUNTIME_CODES}


def remedy(code: str) -> str:
    """The remedy without backquotes, for a terminal. For a code of a newer daemon: the page that lists it."""
    if code not in REASONS:
        return f"docs/reason-codes.md lists cause and remedy of {code}"
    return REASONS[ReasonCode(code)].remedy.replace("`", "")
