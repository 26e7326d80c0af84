"""Tree of all exceptions of twind. Standard library only, Python 3.10.

It is the lowest module: drivers, client and the ROS node under the distribution's Python derive from its
root. A class stands here if several packages raise it, else in the module named beside it. One class stands
for one kind of handling: what no `except` clause separates is one class, and attributes carry the details.
Programming errors are built-in exceptions.

    TwindError
    ├── InvalidInput          data, a file or a value in no permitted form; also a ValueError
    ├── OperationFailed       an operation that cannot be done or completed; also a RuntimeError
    ├── ConfigError           twind.config.yaml_tree: an unusable settings, robot or calibration file
    ├── BusError              twind_drivers.bus: a bus did not do what was requested
    │   ├── PortError         a port that cannot be opened or used; `kind` gives the cause
    │   ├── NoReply           no reply from a device that must answer
    │   ├── DeviceRefused     a device reported an error, or reads back another value than was written
    │   └── WireRangeError    an encoded packet failed its last check and was not sent
    ├── ProcedureFailed       twind.loop.procedures.procedure_runner: arming or homing ended early
    ├── ClientError           twind.client.errors: a call did not do what was requested
    │   ├── NoDaemon          no daemon can be reached
    │   ├── Disconnected      the daemon closed the connection
    │   ├── NoAnswer          no answer in time; also a TimeoutError
    │   ├── NotCarried        the connection to this daemon does not carry such a call
    │   ├── MotionFailed      a motion was stopped, replaced or aborted
    │   └── CallError         the daemon answered with an error
    │       └── Refused       the gate or the daemon refused; `findings` gives the reasons
    ├── UsageError            twind.command_line.verb: a command line that cannot be understood; exit code 2
    ├── Rejected              twind.command_line.verb: a command that was not carried out; exit code 1
    └── CheckNotApplicable    twind.doctor.check: the machine lacks what a check is about
"""

from collections.abc import Sequence


class TwindError(Exception):
    """Root of all exceptions of twind."""


class InvalidInput(TwindError, ValueError):
    """Data, a file or a value from outside that has no permitted form.

    `where` names the part: a file, or a parameter such as `points[3].positions[0]`. `reason` is the text
    without it. `position` is the offset in a text, in characters. `near` are the nearest valid names.
    """

    def __init__(
        self, reason: str, *, where: str = "", position: int | None = None, near: Sequence[str] = ()
    ) -> None:
        super().__init__(f"{where}: {reason}" if where else reason)
        self.reason = reason
        self.where = where
        self.position = position
        self.near = tuple(near)


class OperationFailed(TwindError, RuntimeError):
    """An operation that cannot be done or completed: a resource is missing, in use or without a reply."""
