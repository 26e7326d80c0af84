"""Wait for replies of several buses at once, within a tick; and for scripts, over several ticks."""

from collections.abc import Callable, Collection, Generator, Iterable, Sequence
from math import inf
from typing import Any

from twind.loop.bus.bus_port import BusPort
from twind.loop.bus.script_run import ScriptRun
from twind.robot.joint_map import JointBusMap
from twind_drivers.bus import BusReader, PortError
from twind_drivers.clock import Clock

Pair = tuple[BusPort, JointBusMap]

TOGETHER = 0.00015  # s: replies of two buses that end so close together are read after one wait


def ripe(readers: Sequence[BusReader], clock: Clock) -> Collection[int]:
    """Wait until a reader may have its complete reply, or its deadline passes.

    Return the places of such readers.

    The wait ends no earlier than a reply is expected: on a CAN bus each frame would otherwise wake this
    process, two dozen times a reading. Replies that end close together are read together.
    """
    now = clock.now()
    earliest = [reader.earliest for reader in readers]
    due = [place for place, at in enumerate(earliest) if at <= now]
    begins = min([at for at in earliest if at > now], default=inf)
    if due and begins - now > TOGETHER:
        until = min(begins, min([readers[place].deadline for place in due]))
        found = clock.wait([readers[place].transport for place in due], until)
        return [due[place] for place in found]
    last = begins if due else begins + TOGETHER
    clock.sleep_until(max([at for at in earliest if at <= last]))
    now = clock.now()
    return [place for place, at in enumerate(earliest) if at <= now]


def collect(
    requested: list[Pair], clock: Clock, lose: Callable[[Pair, PortError], None], *, poll_first: bool = False
) -> float:
    """Feed every requested bus until it is done or its deadline passes.

    Return the time of the first bytes (s). A lost port is given to `lose` and leaves `requested`.

    `poll_first`: read before the first wait. A reply cannot be there while the request still leaves (half
    duplex), and a read costs a system call. A request without a reply is done at once and must not be
    waited for.
    """
    waiting = [(pair[0].reader, pair) for pair in requested if pair[0].reader is not None]
    first = inf
    while waiting:
        if poll_first:
            poll_first = False
            ready: Collection[int] = range(len(waiting))
        elif len(waiting) == 1:
            ready = _ripe_alone(waiting[0][0], clock)
        else:
            ready = ripe([reader for reader, _ in waiting], clock)
        now = clock.now()
        first = min(first, now)
        still = []
        for place, (reader, pair) in enumerate(waiting):
            late = now >= reader.deadline
            try:
                done = (late or place in ready) and reader.feed(now)
            except PortError as error:
                lose(pair, error)
                requested.remove(pair)
                continue
            if not done and not (late and now >= reader.deadline):  # `feed` may begin the next of a chain
                still.append((reader, pair))
        waiting = still
    return first if first < inf else clock.now()


def _ripe_alone(reader: BusReader, clock: Clock) -> Collection[int]:
    """Wait for a single reader, as `ripe` does."""
    earliest = reader.earliest
    if earliest > clock.now():
        clock.sleep_until(earliest)
        return (0,)
    return clock.wait((reader.transport,), reader.deadline)


def all_of(tasks: Iterable[ScriptRun[Any]]) -> Generator[None, float, None]:
    """Wait until every task is done; then raise the first error."""
    waiting = list(tasks)
    while not all(task.done for task in waiting):
        yield
    for task in waiting:
        if task.error is not None:
            raise task.error
