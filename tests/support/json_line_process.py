"""A program of tests in its own process: an order a line of standard input, an answer a line back, JSON."""

import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

HOME = Path(__file__).parents[2]


class JsonLineProcess:
    """The process, asked from a test. It is killed at the end of `with`."""

    def __init__(self, module: str, *arguments: str, environment: Mapping[str, str] | None = None) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=HOME,
            env=environment,
        )

    def ask(self, do: str, **parameters: Any) -> Any:
        """Reply to an order. Raises AssertionError where it failed or the process ended."""
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(json.dumps({"do": do, **parameters}) + "\n")
        self.process.stdin.flush()
        line = self.process.stdout.readline()
        assert line, f"the process ended at {do}: {self.process.poll()}"
        answer = json.loads(line)
        assert "error" not in answer, answer["error"]
        return answer["answer"]

    def signal(self, number: int) -> None:
        """Stop it, let it go on, kill it."""
        self.process.send_signal(number)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.process.kill()
        self.process.wait(10)
        for pipe in (self.process.stdin, self.process.stdout):
            assert pipe is not None
            pipe.close()


def obey(node: object) -> None:
    """In the process: call the method of `node` that each line names, until standard input ends."""
    for line in sys.stdin:
        order = json.loads(line)
        try:
            answer = {"answer": getattr(node, order.pop("do"))(**order)}
        except Exception as error:
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), flush=True)
