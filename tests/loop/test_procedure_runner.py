"""Work of several ticks: who owns the torque, what runs beside it, and who is ended by whom."""

from collections.abc import Iterator

import pytest

from twind.loop.bus.bus_port import ScriptRun
from twind.loop.procedures.procedure_runner import Priority, Procedure, ProcedureRunner, all_of, ticks
from twind_drivers.bus import BusError, PingRequest, Script


class Story:
    """Procedures that write down what happens to them."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def body(self, name: str, steps: int = 100) -> Procedure:
        self.lines.append(f"{name} begins")
        try:
            for _ in range(steps):
                now = yield
                self.lines.append(f"{name} at {now:g}")
        except GeneratorExit:
            self.lines.append(f"{name} is ended")
            raise
        self.lines.append(f"{name} is done")


@pytest.fixture
def story() -> Story:
    return Story()


def nothing() -> Procedure:
    return
    yield


@pytest.mark.parametrize("rank", list(Priority))
def test_a_more_urgent_procedure_takes_the_torque_and_a_less_urgent_one_does_not(
    story: Story, rank: Priority
) -> None:
    for other in Priority:
        procedures = ProcedureRunner()
        assert procedures.own(rank, lambda: story.body("first"))
        story.lines.clear()
        taken = procedures.own(other, lambda: story.body("second"))
        assert taken == (other > rank)
        assert procedures.rank == max(rank, other)
        assert story.lines == (["first is ended", "second begins"] if taken else [])


def test_an_estop_is_more_urgent_than_all_else_but_a_cut() -> None:
    order = [
        Priority.ARM,
        Priority.HOME,
        Priority.DISARM,
        Priority.FAULT,
        Priority.SHUTDOWN,
        Priority.ESTOP,
        Priority.CUT,
    ]
    assert sorted(Priority) == order


def test_each_procedure_takes_one_step_per_tick_with_the_current_time(story: Story) -> None:
    procedures = ProcedureRunner()
    procedures.own(Priority.ARM, lambda: story.body("arm", 2))
    procedures.beside(story.body("read", 1))
    assert story.lines == ["arm begins", "read begins"]
    procedures.step(1.0)
    assert story.lines[2:] == ["arm at 1", "read at 1", "read is done"]
    assert procedures.rank is Priority.ARM
    procedures.step(2.0)
    procedures.step(3.0)
    assert story.lines[5:] == ["arm at 2", "arm is done"]
    assert procedures.rank is None


def test_a_procedure_that_ends_at_once_owns_nothing(story: Story) -> None:
    procedures = ProcedureRunner()
    assert procedures.own(Priority.CUT, nothing)
    assert procedures.rank is None
    procedures.beside(nothing())
    procedures.step(1.0)
    assert procedures.own(Priority.ARM, lambda: story.body("arm"))


def test_a_parallel_procedure_is_not_ended_by_a_new_owner(story: Story) -> None:
    procedures = ProcedureRunner()
    procedures.beside(story.body("read"))
    procedures.own(Priority.ARM, lambda: story.body("arm"))
    procedures.own(Priority.CUT, lambda: story.body("cut"))
    procedures.step(1.0)
    assert story.lines == ["read begins", "arm begins", "arm is ended", "cut begins", "cut at 1", "read at 1"]


def test_a_procedure_started_by_another_is_not_lost(story: Story) -> None:
    procedures = ProcedureRunner()

    def parent() -> Procedure:
        yield
        procedures.beside(story.body("child"))

    procedures.beside(parent())
    for now in (1.0, 2.0, 3.0):
        procedures.step(now)
    assert "child at 3" in story.lines


def test_a_parallel_procedure_may_start_a_more_urgent_owner(story: Story) -> None:
    procedures = ProcedureRunner()

    def watcher() -> Procedure:
        yield
        procedures.own(Priority.FAULT, lambda: story.body("fault"))

    procedures.own(Priority.ARM, lambda: story.body("arm"))
    procedures.beside(watcher())
    procedures.step(1.0)
    assert procedures.rank is Priority.FAULT
    assert story.lines == ["arm begins", "arm at 1", "arm is ended", "fault begins"]


def test_abandoning_ends_the_owner_and_is_no_harm_without_one(story: Story) -> None:
    procedures = ProcedureRunner()
    procedures.abandon()
    procedures.own(Priority.DISARM, lambda: story.body("disarm"))
    procedures.abandon()
    assert procedures.rank is None
    assert story.lines == ["disarm begins", "disarm is ended"]


def test_a_procedure_that_breaks_is_gone_after_the_next_step(story: Story) -> None:
    procedures = ProcedureRunner()

    def broken() -> Procedure:
        yield
        raise ZeroDivisionError

    procedures.own(Priority.ARM, broken)
    procedures.beside(story.body("read"))
    with pytest.raises(ZeroDivisionError):
        procedures.step(1.0)
    procedures.step(2.0)
    assert procedures.rank is None
    assert story.lines == ["read begins", "read at 2"]


# ------------------------------------------------------------------------------------- what they wait for


def script() -> Script[None]:
    yield PingRequest(1)


def waiting(task: ScriptRun[None]) -> ScriptRun[None]:
    task.advance(None)
    return task


def test_waiting_for_tasks_ends_when_all_are_done_and_raises_the_first_error() -> None:
    tasks = [waiting(ScriptRun(script())) for _ in range(3)]
    wait: Iterator[None] = all_of(tasks)
    next(wait)
    tasks[1].cancel(BusError("one"))
    next(wait)
    tasks[2].cancel(BusError("two"))
    next(wait)
    tasks[0].done = True
    with pytest.raises(BusError, match="one"):
        next(wait)


def test_waiting_for_nothing_is_over_at_once() -> None:
    assert list(all_of([])) == []


def test_a_tick_counter_returns_the_time_of_its_last_tick() -> None:
    wait = ticks(3)
    next(wait)
    assert [wait.send(now) for now in (1.0, 2.0)] == [None, None]
    with pytest.raises(StopIteration) as stop:
        wait.send(3.0)
    assert stop.value.value == 3.0
