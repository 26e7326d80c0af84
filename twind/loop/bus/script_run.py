"""A script of a bus while it runs: its next request, and its end."""

from dataclasses import dataclass
from typing import Generic, TypeVar

from twind_drivers.bus import BusError, Request, RequestReply, Script

T = TypeVar("T")


@dataclass(eq=False)
class ScriptRun(Generic[T]):
    """A running script, one transaction a tick; `done` with a result, or with the error that ended it."""

    script: Script[T]
    urgent: bool = False  # changes torque: precedes all others, and does not wait for a tick with more room
    request: Request | None = None
    result: T | None = None
    error: BusError | KeyError | ValueError | None = None
    done: bool = False

    def advance(self, reply: RequestReply | None) -> None:
        """Pass the reply to the script (None to begin) and take its next request."""
        try:
            self.request = next(self.script) if reply is None else self.script.send(reply)
        except StopIteration as stop:
            self.result = stop.value
            self._end()
        except (BusError, KeyError, ValueError) as error:
            # The traceback is dropped: it would keep every frame alive, and the collector is off in this
            # process.
            self._end(error.with_traceback(None))
        except Exception as error:
            # It fails this tick. Sent on once more, the script would count as ended well.
            self._end(BusError(f"failed inside: {error!r}"))
            raise

    def cancel(self, error: BusError) -> None:
        """End the script from outside: the port was lost, or a more urgent script came."""
        if not self.done:
            self.script.close()
            self._end(error)

    def _end(self, error: BusError | KeyError | ValueError | None = None) -> None:
        self.error = error
        self.done = True
        self.request = None
