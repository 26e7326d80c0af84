"""A Python module in a process of its own: a request as JSON goes in, an answer as JSON comes out.

Time, memory and output are bounded, and a library that crashes there leaves the process that asks unharmed.
Standard library only, since the child that expands xacro loads it too.
"""

import json
import resource
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from twind.exceptions import InvalidInput

MAX_MESSAGE = 600  # characters of one message


@dataclass(frozen=True, slots=True)
class ProcessBounds:
    """Bounds of one process."""

    seconds: int  # of CPU; four times as much by the clock
    memory: int  # MiB of address space
    output: int  # MiB of each file that it writes, also of its answer

    def apply(self) -> None:
        """Set the bounds for this process. It writes no core file."""
        _lower(resource.RLIMIT_CPU, self.seconds, self.seconds + 1)
        _lower(resource.RLIMIT_AS, self.memory << 20, self.memory << 20)
        _lower(resource.RLIMIT_FSIZE, self.output << 20, self.output << 20)
        _lower(resource.RLIMIT_CORE, 0, 0)


def call_module(
    module: str,
    request: Mapping[str, object],
    bounds: ProcessBounds,
    *,
    file: str,
    environment: Mapping[str, str] | None = None,
) -> Any:
    """Answer of a module to a request, which `read_request` reads there.

    Raises InvalidInput: the module refused, or did not answer a request about `file`.

    `environment`: of the process; None: as this one. The current folder is not on its path.
    """
    command = [sys.executable, "-P", "-m", module]
    with tempfile.TemporaryFile() as answer, tempfile.TemporaryFile() as errors:
        try:
            done = subprocess.run(
                command,
                input=json.dumps({**request, "bounds": asdict(bounds)}).encode(),
                stdout=answer,
                stderr=errors,
                env=None if environment is None else dict(environment),
                timeout=4.0 * bounds.seconds,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise refused_in_one_line(
                f"takes more than {bounds.seconds} s; make it smaller", where=file
            ) from None
        if done.returncode == 0:
            answer.seek(0)
            return _checked(json.loads(answer.read()))
        errors.seek(0)
        raise refused_in_one_line(_reason(done.returncode, bounds, errors.read(1 << 20)), where=file)


def read_request() -> Any:
    """Request of this process, whose bounds hold from now on."""
    request = json.load(sys.stdin)
    ProcessBounds(**request["bounds"]).apply()
    return request


def refusal(error: InvalidInput) -> dict[str, Any]:
    """Answer that `call_module` raises in its caller."""
    return {"refused": {"reason": error.reason, "where": error.where}}


def _lower(kind: int, soft: int, hard: int) -> None:
    """Set a limit of this process; one that is lower already stays."""
    most = resource.getrlimit(kind)[1]
    if most != resource.RLIM_INFINITY:
        hard = min(hard, most)
    resource.setrlimit(kind, (min(soft, hard), hard))


def refused_in_one_line(reason: str, *, where: str) -> InvalidInput:
    """Return the error about the file or place `where`: one line of bounded length."""
    return InvalidInput(" ".join(reason.split())[:MAX_MESSAGE], where=where)


def _checked(answer: Any) -> Any:
    if "refused" in answer:
        raise refused_in_one_line(answer["refused"]["reason"], where=answer["refused"]["where"])
    return answer


def _reason(code: int, bounds: ProcessBounds, errors: bytes) -> str:
    if code in (-signal.SIGXCPU, -signal.SIGKILL):
        return f"takes more than {bounds.seconds} s; make it smaller"
    if b"MemoryError" in errors or b"bad_alloc" in errors:
        return f"needs more than {bounds.memory} MiB of memory; make it smaller"
    if code == -signal.SIGXFSZ or b"File too large" in errors:
        return f"grows to more than {bounds.output} MiB; make it smaller"
    lines = errors.decode(errors="replace").strip().splitlines() or ["no message"]
    return f"the process that reads it ended with code {code}: {lines[-1][:200]}; please report it"
