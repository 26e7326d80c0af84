"""Work of several ticks: who owns the torque, what runs beside it, and who is ended by whom."""

import weakref
from collections.abc import Iterator

import pytest

from twind.loop.bus.bus_wait import all_of
from twind.loop.bus.script_run import ScriptRun
from twind.loop.ipc.call_outcome import CallFailure, CallOutcome, CallReply
from twind.loop.procedures.procedure_runner import (
    Priority,
    Procedure,
    ProcedureFailed,
    ProcedureRunner,
    ticks,
)
from twind.robot.finding import Finding, ReasonCode
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


# ------------------------------------------------------------------------------------- what they answer

DONE = CallReply({"state": "armed"})


def answering(steps: int, outcome: CallOutcome | None = DONE) -> Procedure:
    """A procedure of so many waits."""
    for _ in range(steps):
        yield
    return outcome


@pytest.mark.parametrize("outcome", [DONE, None])
@pytest.mark.parametrize("steps", [0, 1, 3])
@pytest.mark.parametrize("owner", [True, False])
def test_the_outcome_of_a_procedure_reaches_its_caller_once_when_it_ends(
    owner: bool, steps: int, outcome: CallOutcome | None
) -> None:
    procedures = ProcedureRunner()
    answers: list[CallOutcome | None] = []
    if owner:
        procedures.own(Priority.ARM, lambda: answering(steps, outcome), answers.append)
    else:
        procedures.beside(answering(steps, outcome), answers.append)
    for tick in range(5):
        assert answers == ([outcome] if tick >= steps else [])
        procedures.step(float(tick))
    procedures.abandon()
    assert answers == [outcome]


DOING = {
    Priority.ARM: "arming",
    Priority.HOME: "the end-stop search",
    Priority.DISARM: "disarming",
    Priority.FAULT: "fault",
    Priority.SHUTDOWN: "shutdown",
    Priority.ESTOP: "estop",
    Priority.CUT: "cut",
}


@pytest.mark.parametrize("rank", list(Priority))
@pytest.mark.parametrize(("cause", "text"), [("", "something more urgent"), ("ESTOP: a", "ESTOP: a")])
def test_a_procedure_that_is_ended_by_force_is_answered_with_what_is_latched(
    rank: Priority, cause: str, text: str
) -> None:
    procedures = ProcedureRunner(lambda: cause)
    answers: list[CallOutcome | None] = []
    procedures.own(rank, lambda: answering(9), answers.append)
    procedures.abandon()
    procedures.abandon()
    procedures.step(1.0)
    assert answers == [CallFailure("Busy", {"what": f"{DOING[rank]} was ended by {text}"})]


def test_without_a_cause_given_something_more_urgent_ends_it() -> None:
    procedures = ProcedureRunner()
    answers: list[CallOutcome | None] = []
    procedures.own(Priority.ARM, lambda: answering(9), answers.append)
    procedures.own(Priority.CUT, lambda: answering(9))
    assert answers == [CallFailure("Busy", {"what": "arming was ended by something more urgent"})]
    assert procedures.rank is Priority.CUT


def test_the_answer_of_one_that_is_ended_precedes_the_next_one(story: Story) -> None:
    procedures = ProcedureRunner()
    procedures.own(Priority.ARM, lambda: story.body("arm"), lambda _: story.lines.append("answered"))
    procedures.own(Priority.CUT, lambda: story.body("cut"))
    assert story.lines == ["arm begins", "arm is ended", "answered", "cut begins"]


@pytest.mark.parametrize("owner", [True, False])
def test_a_procedure_that_breaks_is_answered_in_the_next_tick(owner: bool) -> None:
    def broken() -> Procedure:
        yield
        raise ZeroDivisionError

    procedures = ProcedureRunner()
    answers: list[CallOutcome | None] = []
    if owner:
        procedures.own(Priority.DISARM, broken, answers.append)
    else:
        procedures.beside(broken(), answers.append)
    with pytest.raises(ZeroDivisionError):
        procedures.step(1.0)
    assert answers == []
    procedures.step(2.0)
    procedures.step(3.0)
    assert answers == [CallFailure("Busy", {"what": "failed inside"})]


@pytest.mark.parametrize("rank", list(Priority))
def test_a_procedure_that_breaks_at_once_owns_nothing_and_its_caller_answers(
    rank: Priority, story: Story
) -> None:
    def broken() -> Procedure:
        raise ZeroDivisionError
        yield

    procedures = ProcedureRunner()
    answers: list[CallOutcome | None] = []
    with pytest.raises(ZeroDivisionError):
        procedures.own(rank, broken, answers.append)
    assert procedures.rank is None
    procedures.step(1.0)
    assert answers == [], "the caller received the exception, and answers once"
    assert procedures.own(Priority.ARM, lambda: story.body("arm"))


def test_a_procedure_that_breaks_at_once_has_ended_the_one_before_it() -> None:
    def broken() -> Procedure:
        raise ZeroDivisionError
        yield

    procedures = ProcedureRunner()
    answers: list[CallOutcome | None] = []
    procedures.own(Priority.ARM, lambda: answering(9), answers.append)
    with pytest.raises(ZeroDivisionError):
        procedures.own(Priority.CUT, broken)
    procedures.step(1.0)
    assert answers == [CallFailure("Busy", {"what": "arming was ended by something more urgent"})]
    assert procedures.rank is None


def test_an_owner_that_the_end_of_another_begins_is_kept(story: Story) -> None:
    procedures = ProcedureRunner()

    ranks: list[Priority | None] = []

    def next_one(_outcome: CallOutcome | None) -> None:
        ranks.append(procedures.rank)
        procedures.own(Priority.FAULT, lambda: story.body("fault"))

    procedures.own(Priority.ARM, lambda: answering(1), next_one)
    procedures.step(1.0)
    assert ranks == [None], "its end precedes its answer"
    assert procedures.rank is Priority.FAULT
    procedures.step(2.0)
    assert story.lines == ["fault begins", "fault at 2"]


def test_a_procedure_that_has_ended_is_answered_once_though_another_breaks_in_the_same_tick() -> None:
    def broken() -> Procedure:
        yield
        raise ZeroDivisionError

    procedures = ProcedureRunner()
    answers: list[CallOutcome | None] = []
    procedures.beside(answering(1), answers.append)
    procedures.beside(broken())
    with pytest.raises(ZeroDivisionError):
        procedures.step(1.0)
    procedures.step(2.0)
    procedures.step(3.0)
    assert answers == [DONE]


def test_a_procedure_that_has_ended_is_forgotten() -> None:
    procedures = ProcedureRunner()
    body = answering(1)
    kept = weakref.ref(body)
    procedures.beside(body)
    del body
    assert kept() is not None
    procedures.step(1.0)
    assert kept() is None


def test_what_the_end_of_one_begins_beside_it_runs(story: Story) -> None:
    procedures = ProcedureRunner()
    procedures.beside(answering(1), lambda _: procedures.beside(story.body("read", 2)))
    procedures.step(1.0)
    procedures.step(2.0)
    assert "read at 2" in story.lines


def test_an_owner_that_has_ended_is_not_ended_again() -> None:
    procedures = ProcedureRunner()
    answers: list[CallOutcome | None] = []
    procedures.own(Priority.ARM, lambda: answering(1), answers.append)
    procedures.step(1.0)
    procedures.step(2.0)
    procedures.own(Priority.ARM, lambda: answering(1, None))
    assert answers == [DONE]


def test_the_urgencies_are_numbered_from_one() -> None:
    assert [int(rank) for rank in Priority] == [1, 2, 3, 4, 5, 6, 7]


def test_a_failure_carries_its_finding() -> None:
    failed = ProcedureFailed.measured(ReasonCode.ARM_FAILED, 3, 2, "far", 1)
    assert failed.finding == Finding(ReasonCode.ARM_FAILED, 1, value=3.0, bound=2.0, message="far")
    assert str(failed) == "far"
    assert ProcedureFailed.measured(ReasonCode.ARM_FAILED, 3, 2, "far").finding.joint is None


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
