"""The dead-man rule under a clock of the test: what comes late, twice or from elsewhere moves nothing."""

from dataclasses import dataclass, field

from hypothesis import given
from hypothesis import strategies as st

from twind.observe.viewing.dead_man_hold import DeadManHold, HoldPhase, Press
from twind.robot_client.jog_motion import HOLD

TINY = 1e-9  # s


def held(hold: DeadManHold, press: Press, now: float) -> bool:
    return hold.phase(press, now) is HoldPhase.HELD


def begun(now: float = 10.0) -> tuple[DeadManHold, Press]:
    """A press whose page has returned its first token at once."""
    hold = DeadManHold()
    press = Press(1, 1)
    assert hold.press(press, now)
    token = hold.issue(press, now)
    assert token is not None and hold.beat(press, token, now)
    return hold, press


def test_a_press_alone_moves_nothing() -> None:
    hold = DeadManHold()
    press = Press(1, 1)
    assert hold.press(press, 10.0)
    assert hold.phase(press, 10.0) is HoldPhase.PRESSED
    assert hold.phase(press, 10.0 + HOLD + TINY) is HoldPhase.ENDED


def test_a_hold_lasts_as_long_as_its_newest_token_and_does_not_come_back() -> None:
    hold, press = begun(10.0)
    token = hold.issue(press, 10.1)
    assert token is not None
    assert held(hold, press, 10.0 + HOLD - TINY)
    assert not held(hold, press, 10.0 + HOLD + TINY)
    assert not hold.beat(press, token, 10.16)  # it is young enough, but the hold has lapsed
    assert not held(hold, press, 10.16)


def test_a_token_counts_from_its_issue_not_from_its_return() -> None:
    hold, press = begun(10.0)
    token = hold.issue(press, 10.05)
    assert token is not None and hold.beat(press, token, 10.14)
    assert held(hold, press, 10.05 + HOLD - TINY)
    assert not held(hold, press, 10.05 + HOLD + TINY)


def test_a_token_that_returns_twice_counts_once_and_one_that_was_never_issued_not_at_all() -> None:
    hold, press = begun(10.0)
    token = hold.issue(press, 10.01)
    assert token is not None and hold.beat(press, token, 10.02)
    assert not hold.beat(press, token, 10.03)
    assert not hold.beat(press, token + 1, 10.03)


def test_a_release_ends_the_hold_and_a_press_that_it_overtook_does_not_begin() -> None:
    hold, press = begun(10.0)
    hold.release(Press(1, 2))
    assert not held(hold, press, 10.0)
    assert not hold.press(Press(1, 2), 10.0)
    assert hold.press(Press(1, 3), 10.0)


def test_another_tab_neither_begins_nor_ends_nor_prolongs_a_hold() -> None:
    hold, press = begun(10.0)
    token = hold.issue(press, 10.01)
    assert not hold.press(Press(2, 1), 10.01)
    assert token is not None and not hold.beat(Press(2, 1), token, 10.02)
    hold.release(Press(2, 1))
    hold.forget(2)
    assert held(hold, press, 10.02)
    hold.forget(1)
    assert not held(hold, press, 10.02)


def test_a_clock_that_is_unknown_or_goes_back_ends_the_hold() -> None:
    for wrong in (9.0, float("nan")):
        hold, press = begun(10.0)
        assert not held(hold, press, wrong)
        assert not held(hold, press, 10.0)


@dataclass
class TwoTabs:
    """Two pages and a network that delays, doubles and swaps messages; `until`: what a true return allows."""

    hold: DeadManHold = field(default_factory=DeadManHold)
    now: float = 10.0  # s
    numbers: dict[int, int] = field(default_factory=lambda: {1: 0, 2: 0})
    sent: list[Press] = field(default_factory=list)
    issued: list[tuple[Press, int, float]] = field(default_factory=list)
    until: dict[Press, float] = field(default_factory=dict)
    over: set[Press] = field(default_factory=set)  # presses that a release or a closed tab has ended
    moved: bool = False

    def wait(self, seconds: float) -> None:
        self.now += seconds

    def press(self, tab: int) -> None:
        self.numbers[tab] += 1
        self.sent.append(Press(tab, self.numbers[tab]))
        self.hold.press(self.sent[-1], self.now)

    def press_again(self, back: int) -> None:
        if back < len(self.sent):
            self.hold.press(self.sent[-1 - back], self.now)

    def issue(self, back: int) -> None:
        press = self.sent[-1 - back] if back < len(self.sent) else Press(1, 1)
        token = self.hold.issue(press, self.now)
        if token is not None:
            self.issued.append((press, token, self.now))

    def beat(self, back: int) -> None:
        if back < len(self.issued):
            press, token, at = self.issued[-1 - back]
            self.hold.beat(press, token, self.now)
            self.until[press] = max(self.until.get(press, 0.0), at + HOLD)

    def beat_of_another(self, back: int) -> None:
        if back < len(self.issued):
            press, token, _ = self.issued[-1 - back]
            self.hold.beat(Press(3 - press.tab, max(1, self.numbers[3 - press.tab])), token, self.now)

    def release(self, back: int) -> None:
        if back < len(self.sent):
            self.hold.release(self.sent[-1 - back])
            self.over |= {each for each in self.sent if each.tab == self.sent[-1 - back].tab}

    def close(self, back: int) -> None:
        if back < len(self.sent):
            tab = self.sent[-1 - back].tab
            self.hold.forget(tab)
            self.over |= {each for each in self.sent if each.tab == tab}
            self.numbers[tab] += 1  # a page that comes after it has another number

    def check(self) -> None:
        moving = [press for press in set(self.sent) if held(self.hold, press, self.now)]
        assert len(moving) <= 1
        for press in moving:
            assert self.now <= self.until.get(press, 0.0) + TINY
            assert press not in self.over
        self.moved |= bool(moving)


RECENT = st.integers(0, 3)
WAITS = st.sampled_from([0.02, 0.04, 0.1, 0.14, HOLD + TINY])  # s
USUAL = ("press", "issue", "beat", "wait", "issue", "beat")
STEPS = st.one_of(
    st.sampled_from(USUAL).map(lambda name: (name, 1 if name == "press" else 0.02 if name == "wait" else 0)),
    st.tuples(st.just("wait"), WAITS),
    st.tuples(st.just("press"), st.integers(1, 2)),
    st.tuples(st.sampled_from(["issue", "beat"]), RECENT),
    st.tuples(st.sampled_from(["press_again", "beat_of_another", "release", "close"]), RECENT),
)
BEGUN = [("press", 1), ("issue", 0), ("beat", 0), ("wait", 0.04), ("issue", 0)]
RETURNED = [("issue", 0), ("beat", 0)]


@given(st.sampled_from([[], BEGUN]), st.lists(STEPS, min_size=1, max_size=40))
def test_no_sequence_of_messages_moves_longer_than_the_bound_after_the_last_true_heartbeat(
    before: list[tuple[str, float]], steps: list[tuple[str, float]]
) -> None:
    tabs = TwoTabs()
    for name, value in [*before, *steps, *RETURNED]:
        getattr(tabs, name)(value)
        tabs.check()
