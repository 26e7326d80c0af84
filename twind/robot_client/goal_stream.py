"""Goals at a steady rate that never wait for a tick of the daemon: `Robot.stream`."""

import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from twind.client import ClientError, Refused
from twind.exceptions import InvalidInput
from twind.robot.arrays import Floats
from twind.robot_client.control_timing import RateTimer, validity

KEPT = 1000  # changes that the report keeps

Goals = Mapping[str, float] | ArrayLike


class GoalSender(Protocol):
    """Sends a `Setpoint` of the interface. Raises ClientError."""

    def __call__(self, **parameters: Any) -> Mapping[str, Any]:
        """Return the answer."""


@dataclass(slots=True)
class StreamReport:
    """Fate of the goals of a stream so far."""

    sent: int = 0  # goals given to `send`
    accepted: int = 0  # by the gate
    superseded: int = 0  # replaced by a newer one before the daemon took them
    refused: int = 0
    refusal: ClientError | None = None  # the last one
    late: int = 0  # periods that the caller missed
    answer_s: float = 0.0  # longest wait for an answer
    behind: dict[str, float] = field(default_factory=dict)  # rad, joints that cannot keep up now
    # made by the gate, the newest last
    changes: deque[Mapping[str, Any]] = field(default_factory=lambda: deque(maxlen=KEPT), repr=False)


class GoalStream:
    """A stream of goals. Of one thread; made by `Robot.stream`, used as a context.

    A thread of its own sends the newest goal as soon as the daemon has answered the one before, at most once
    a tick. So `send` returns at once. When goals end or the process stops, the robot decelerates and holds
    within `valid_for`.
    """

    def __init__(
        self,
        send_setpoint: GoalSender,
        joints: Sequence[str],
        velocity_limits: Floats,
        rate: float,
        *,
        scale: float = 1.0,
        clamp: bool = False,
        strict: bool = True,
    ) -> None:
        """`velocity_limits`: rad/s, (k,) of `joints`; `scale`: rad per unit of the goals.

        `strict`: the next `send` after a refusal raises it; else it is counted.
        """
        if not 1.0 <= rate <= 1000.0:
            raise InvalidInput(f"rate {rate:g} Hz: use 1 to 1000")
        self.joints = tuple(joints)
        self.report = StreamReport()
        self.period = 1.0 / rate
        self.valid_for = validity(self.period)
        self.expires = (
            False  # goals that wait on their way are not followed longer than `valid_for` after `send`
        )
        self._send_setpoint = send_setpoint
        self._limits = velocity_limits
        self._scale = scale
        self._clamp = clamp or None
        self._strict = strict
        self._previous: Floats | None = None
        self._next: tuple[Floats, Floats, float | None] | None = None
        self._failure: Exception | None = None
        self._news = threading.Condition()
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="goals", daemon=True)

    def __enter__(self) -> "GoalStream":
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._news:
            self._ended = True
            self._news.notify_all()
        self._thread.join()
        if kind is None:
            self._raise_failure()

    def __iter__(self) -> Iterator[float]:
        """Yield the seconds since the first one at the rate of the stream, without end.

        Periods that the caller missed are left out and counted in `report.late`.
        """
        start = time.monotonic()
        timer = RateTimer(start, self.period)
        while True:
            yield timer.deadline - start
            self.report.late += timer.advance(time.monotonic())
            time.sleep(max(0.0, timer.deadline - time.monotonic()))

    def send(self, goals: Goals, velocities: Goals | None = None) -> None:
        """Give the next goals: by name, or an array in the order of `joints`. Never waits for the daemon.

        `velocities`: at the goals, per second. Without them they follow from the goals before, and a step
        faster than a joint's limit is a target to stop at. Raises the error of an earlier goal: Refused, if
        strict; other ClientError. Raises InvalidInput: a joint that is not in the
        stream, or a number that is not finite.
        """
        self._raise_failure()
        until = time.monotonic() + self.valid_for if self.expires else None
        setpoint = (*self._setpoint(goals, velocities), until)
        with self._news:
            self.report.sent += 1
            self.report.superseded += self._next is not None
            self._next = setpoint
            self._news.notify_all()

    def send_and_wait(self, goals: Goals, velocities: Goals | None = None) -> Sequence[Mapping[str, Any]]:
        """Give the next goals as `send`, and wait a tick or two for the answer: the changes of the gate.

        Each change has `code`, `joint`, `value` and `bound`. Raises Refused, strict or not; else as `send`.
        """
        position, velocity = self._setpoint(goals, velocities)
        with self._news:
            self.report.sent += 1
        return self._exchange(position, velocity)

    def _setpoint(self, goals: Goals, velocities: Goals | None) -> tuple[Floats, Floats]:
        position = self._row(goals, self._previous)
        if velocities is not None:
            velocity = self._row(velocities, np.zeros(len(self.joints)))
        elif self._previous is None:
            velocity = np.zeros(len(self.joints))
        else:
            velocity = (position - self._previous) / self.period
            velocity[np.abs(velocity) > self._limits] = 0.0
        self._previous = position
        return position, velocity

    def _row(self, values: Goals, others: Floats | None) -> Floats:
        """Return values as a row (k,) in rad; joints that a mapping leaves out are as in `others`."""
        if isinstance(values, Mapping):
            unknown = [name for name in values if name not in self.joints]
            if unknown:
                raise InvalidInput(f"{unknown[0]} is not in the stream; its joints: {', '.join(self.joints)}")
            missing = [name for name in self.joints if name not in values]
            if missing and others is None:
                raise InvalidInput(f"the first goals need every joint of the stream; missing: {missing[0]}")
            known = np.zeros(len(self.joints)) if others is None else others / self._scale
            row = np.array(
                [values.get(name, at) for name, at in zip(self.joints, known.tolist(), strict=True)],
                np.float64,
            )
        else:
            row = np.array(values, np.float64)
        if row.shape != (len(self.joints),):
            raise InvalidInput(f"goals have the shape {row.shape}; the stream has {len(self.joints)} joints")
        if not np.isfinite(row).all():
            raise InvalidInput(f"{self.joints[int(np.argmin(np.isfinite(row)))]}: the goal is not finite")
        return row * self._scale

    def _raise_failure(self) -> None:
        with self._news:
            failure = self._failure
            self._failure = None
        if failure is not None:
            raise failure

    def _run(self) -> None:
        while True:
            with self._news:
                while self._next is None and not self._ended:
                    self._news.wait()
                if self._next is None:
                    return
                setpoint = self._next
                self._next = None
            try:
                self._exchange(*setpoint)
            except Exception as error:  # noqa: BLE001  a thread that dies in silence would send nothing for ever
                with self._news:
                    self._failure = error if self._strict or not isinstance(error, Refused) else None

    def _exchange(
        self, position: Floats, velocity: Floats, until: float | None = None
    ) -> Sequence[Mapping[str, Any]]:
        """Send a setpoint, wait for its answer, report it; return the changes. Raises ClientError."""
        begun = time.monotonic()
        try:
            answer = self._send_setpoint(
                joint_names=list(self.joints),
                positions=position.tolist(),
                velocities=velocity.tolist(),
                valid_for=self.valid_for,
                valid_until=until,
                allow_clamp=self._clamp,
            )
        except ClientError as error:
            with self._news:
                self.report.refusal = error
                self.report.refused += 1
            raise
        behind = answer.get("behind") or ()
        with self._news:
            self.report.accepted += 1
            self.report.answer_s = max(self.report.answer_s, time.monotonic() - begun)
            self.report.behind = {
                name: far for name, far in zip(self.joints, behind, strict=False) if far is not None
            }
            changes: Sequence[Mapping[str, Any]] = answer.get("changes") or ()
            self.report.changes.extend(changes)
        return changes
