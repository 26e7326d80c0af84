"""Content of a recording in a format that is not ours: one refusal for all readers."""

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec

from twind.command_line.verb import Rejected
from twind.exceptions import InvalidInput

# Errors that follow from content: of codecs, of missing keys, and of numbers that do not fit.
FOREIGN = (
    *(struct.error, ValueError, TypeError, AttributeError, LookupError, ArithmeticError, RecursionError),
    msgspec.MsgspecError,
)


@contextmanager
def refuse_foreign_content(path: Path) -> Iterator[None]:
    """Raise Rejected, naming the file, in place of the error that foreign content ends in."""
    try:
        yield
    except InvalidInput as error:
        raise Rejected(f"{error.where or path}: {error.reason}") from None
    except FOREIGN as error:
        kind = type(error).__name__
        said = " ".join(str(error).split())[:200]
        reason = f"a message on our topics, or a JointState, is not in our format ({kind}: {said})"
        raise Rejected(f"{path}: {reason}; record it again") from None
    except MemoryError:
        raise Rejected(f"{path}: it claims more than the memory of this machine; record it again") from None
