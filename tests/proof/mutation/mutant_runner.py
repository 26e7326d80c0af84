"""Judges the mutants of a room inside one pytest session: a process for each, only tests that run its line.

The tests are collected once. One forked child runs them all under coverage and tells which test runs which
line. Then each mutant gets a child of its own: a change inside a function is put into the living function, a
change of what runs at import (a constant, a table, a default, what a test module asks for at its top) into a
fresh import of everything. The first failing test ends the child.
"""

import gc
import json
import os
import resource
import signal
import sys
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import coverage
import hypothesis
import pytest

from tests.proof.mutation.mutated_code import Case, ChangedModule, forget, living, transplant
from tests.proof.mutation.rooms import HOME, Room

JOBS = len(os.sched_getaffinity(0))  # `taskset -c 0` leaves the others free
PATIENCE = 300.0  # s of waiting for one child: its share of CPU time ends it long before
MEMORY = 3 << 30  # bytes a child may map
FEW = 20  # generated examples of a test at the first try: they nearly always kill what all of them kill
QUIET = (
    *("-o", "addopts=", "-p", "no:terminal", "-p", "no:cacheprovider", "-s", "-x"),
    *("-m", "not slow and not campaign and not realtime", "-p", "tests.proof.mutation.calm"),
    "--noconftest",  # the fixtures import the whole daemon
    *("-W", "ignore::pytest.PytestAssertRewriteWarning"),  # what a session within a session imports again
)


@dataclass
class MutantRunner:
    """A pytest plugin: takes the place of the run of the tests."""

    room: Room
    cases: list[Case]
    deadline: float = float("inf")  # s, monotonic: no mutant is begun later
    remember: Callable[[Case], None] = lambda case: None  # called with each verdict
    listed: Collection[str] = ()  # names of survivors that are known: they are not tried twice
    brief: bool = False  # no mutant is tried twice
    judged: list[Case] = field(default_factory=list)
    _touching: dict[str, dict[int, list[str]]] = field(default_factory=dict)
    _seconds: dict[str, float] = field(default_factory=dict)
    _killers: dict[tuple[str, str], list[str]] = field(default_factory=dict)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        self._items = {item.nodeid: item for item in session.items}
        self._session = session
        self._survey()
        gc.freeze()  # a child that collects would copy every page
        again = []
        for case in _side_by_side(self.cases, self._quick, self._verdict, self.deadline):
            self.judged.append(case)
            if case.killer or case.name in self.listed:
                self.remember(case)
            elif not self.brief:
                again.append(case)
        for case in _side_by_side(again, self._thorough, self._verdict, float("inf")):
            self.remember(case)
        return True

    # -------------------------------------------------------------------------------- which test runs what

    def _survey(self) -> None:
        """Note which test runs which line of each module ("": the import does), and its duration."""
        reader, writer = os.pipe()
        child = os.fork()
        if not child:
            os.close(reader)
            _leave(lambda: self._covered(writer))
        os.close(writer)
        with os.fdopen(reader) as pipe:
            report = pipe.read()
        if os.waitpid(child, 0)[1] or not report:
            raise SystemExit(f"{self.room.name}: the tests fail without any mutant")
        self._seconds, touching = json.loads(report)
        self._touching = {
            module: {int(line): tests for line, tests in lines.items()} for module, lines in touching.items()
        }

    def _covered(self, writer: int) -> int:
        forget()
        survey = _Survey([str(HOME / module) for module in self.room.modules])
        code = pytest.main([*QUIET, *self._items], plugins=[survey])
        data = survey.cov.get_data()
        touching = {module: data.contexts_by_lineno(str(HOME / module)) for module in self.room.modules}
        with os.fdopen(writer, "w") as pipe:
            json.dump((survey.seconds, touching), pipe)
        return int(code)

    def _touched(self, case: Case) -> set[str]:
        """The tests that run the mutant's lines; "" among them where the import does."""
        if hasattr(living(case), "cache_clear"):
            return set(self._items)  # only the first test that asks runs a cached function
        lines = self._touching[case.module]
        first, last = case.mutant.lines
        chosen = range(first, last + 1) if case.mutant.scope else lines
        return {test for line in chosen for test in lines.get(line, ())}

    def _ordered(self, case: Case, tests: Iterable[str]) -> list[str]:
        """The likeliest killers first, then the quickest."""
        known = self._killers.get((case.module, case.mutant.scope), [])
        rank = {test: place for place, test in enumerate(known)}
        return sorted(tests, key=lambda test: (rank.get(test, len(rank)), self._seconds[test]))

    # ------------------------------------------------------------------------------------------- children

    def _quick(self, case: Case) -> tuple[int, int] | None:
        return self._tried(case, FEW)

    def _thorough(self, case: Case) -> tuple[int, int] | None:
        return self._tried(case, None)

    def _tried(self, case: Case, examples: int | None) -> tuple[int, int] | None:
        """A child that tries the mutant: (pid, reading end of its pipe); None where no test runs the line.

        Tests of generated examples look at `examples` of them at most; None: at as many as they say.
        """
        touched = self._touched(case)
        case.covered = bool(touched)
        near = touched & set(self._items)
        if "" not in touched:
            tests = self._ordered(case, near)
            return (
                self._child(tests, lambda report: self._inside(case, tests, report, examples))
                if tests
                else None
            )
        every = [*self._ordered(case, near), *self._ordered(case, set(self._items) - near)]
        return self._child(every, lambda report: self._anew(case, every, report, examples))

    def _child(self, tests: Sequence[str], work: Callable[[int], int]) -> tuple[int, int]:
        reader, writer = os.pipe()
        child = os.fork()
        if child:
            os.close(writer)
            return child, reader
        os.close(reader)
        share = int(5.0 * sum(self._seconds[test] for test in tests)) + 5
        resource.setrlimit(resource.RLIMIT_CPU, (share, share + 5))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        _leave(lambda: work(writer))
        raise AssertionError("unreachable")

    def _inside(self, case: Case, tests: list[str], report: int, examples: int | None) -> int:
        """The change goes into the living function; tests run until the first that fails."""
        try:
            transplant(case)
        except ValueError:  # other free variables: the code does not fit into the living function
            return self._anew(case, tests, report, examples)
        _thin(self._items.values(), examples)
        for item, after in _in_turn([self._items[test] for test in tests]):
            _bound(self._seconds[item.nodeid])
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
            if self._session.testsfailed:
                os.write(report, item.nodeid.encode()[:500])
                return 1
        return 0

    def _anew(self, case: Case, tests: list[str], report: int, examples: int | None) -> int:
        """The change goes into the source before anything is imported."""
        forget()
        sys.meta_path.insert(0, ChangedModule(case))
        first = _FirstFailure(examples, self._seconds)
        code = pytest.main([*QUIET, *tests], plugins=[first])
        if code == pytest.ExitCode.USAGE_ERROR:  # a test's name has what was changed in it
            forget()
            code = pytest.main([*QUIET, *dict.fromkeys(test.partition("::")[0] for test in tests)], [first])
        if code:
            os.write(report, (first.name or f"does not load ({code})").encode()[:500])
        return int(code != 0)

    def _verdict(self, case: Case, status: int, report: str) -> None:
        if status:
            case.killer = report or "timeout"
            if report:
                known = self._killers.setdefault((case.module, case.mutant.scope), [])
                known[:] = [report, *(test for test in known if test != report)]


class _Survey:
    """A plugin: coverage of the import and of each test."""

    def __init__(self, files: list[str]) -> None:
        self.cov = coverage.Coverage(data_file=None, include=files, config_file=False)
        self.seconds: dict[str, float] = {}
        self.cov.start()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        self.cov.switch_context(item.nodeid)
        begun = time.process_time()
        report = yield
        self.seconds[item.nodeid] = time.process_time() - begun
        self.cov.switch_context("")
        return report

    def pytest_sessionfinish(self) -> None:
        self.cov.stop()


class _FirstFailure:
    """A plugin: fewer examples, a bound on each test's time, and the name of the first test that fails."""

    def __init__(self, examples: int | None, seconds: dict[str, float]) -> None:
        self.name = ""
        self._examples = examples
        self._seconds = seconds

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        _thin(items, self._examples)

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        _bound(self._seconds.get(nodeid, 0.0))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.name = self.name or (report.nodeid if report.failed else "")


def _in_turn(items: list[pytest.Item]) -> Iterator[tuple[pytest.Item, pytest.Item | None]]:
    return zip(items, [*items[1:], None], strict=True)


def _leave(work: Callable[[], int]) -> None:
    """Run a child's work in silence, and end the child."""
    code = 1
    try:
        silence = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(silence, stream)
        code = work()
    finally:
        os._exit(code)


def _side_by_side(
    cases: list[Case],
    begin: Callable[[Case], tuple[int, int] | None],
    end: Callable[[Case, int, str], None],
    deadline: float,
) -> Iterator[Case]:
    """Each case in a child of its own, `JOBS` at a time. Yields what was judged."""
    waiting = list(reversed(cases))
    running = dict[int, tuple[Case, int, float]]()
    while waiting or running:
        while waiting and len(running) < JOBS and time.monotonic() < deadline:
            case = waiting.pop()
            begun = begin(case)
            if begun is None:
                yield case
            else:
                running[begun[0]] = case, begun[1], time.monotonic() + PATIENCE
        if not running:
            return
        pid, status = os.waitpid(-1, os.WNOHANG)
        if not pid:
            for late in [pid for pid, (_, _, until) in running.items() if time.monotonic() > until]:
                os.kill(late, signal.SIGKILL)
            time.sleep(0.002)
        elif pid in running:
            case, reader, _ = running.pop(pid)
            with os.fdopen(reader) as pipe:
                end(case, status, pipe.read())
            yield case


def _bound(seconds: float) -> None:
    """End this process where a test takes far more CPU time than the `seconds` it takes without a mutant."""
    signal.setitimer(signal.ITIMER_PROF, 2.0 + 5.0 * seconds)


def _thin(items: Iterable[pytest.Item], examples: int | None) -> None:
    """At most so many generated examples of each test."""
    for item in items:
        test = getattr(item, "obj", None)
        own = getattr(test, "_hypothesis_internal_use_settings", None)
        if own is not None and examples is not None and own.max_examples > examples:
            test._hypothesis_internal_use_settings = hypothesis.settings(own, max_examples=examples)


def judge(
    room: Room,
    cases: list[Case],
    deadline: float,
    remember: Callable[[Case], None],
    listed: Collection[str],
    brief: bool,
) -> list[Case]:
    """Judge `cases`; those that were begun before `deadline` (s, monotonic). `remember` is called with each.

    `brief`: tests of generated examples look at few of them only, and what survives may yet be noticed.
    """
    court = MutantRunner(room, cases, deadline, remember, listed, brief)
    tests = [str(Path(HOME, test)) for test in room.tests if Path(HOME, test).exists()]
    code = pytest.main([*QUIET, "--rootdir", str(HOME), *tests], plugins=[court])
    if code:
        raise SystemExit(f"{room.name}: pytest ended with {code!r}")
    return court.judged
