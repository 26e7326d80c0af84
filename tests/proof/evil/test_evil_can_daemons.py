"""The monitor of a CAN bus is proved by what it catches: each wrong daemon by its rule, the right by none."""

import ast
from pathlib import Path

import pytest

import tests.proof.busmon.can
from tests.proof.busmon.can.monitor import CanMonitor
from tests.proof.busmon.can.motors import CanLimits
from tests.proof.evil import can_world
from tests.proof.evil.accusations import Accusation, accusations, without
from tests.proof.evil.can_every import EVILS
from tests.proof.evil.can_good import Cutting, Good, Killed, Mirror, Reborn, packed
from tests.proof.evil.can_nodes import CUBEMARS, DAMIAO, reply_frame
from tests.proof.evil.registry import Evil
from tests.support.examples import fast_cases

RULES = {"W1", "W2", "W3", "W4", "W5", "W6", "W7", "W8", "W10", "W11"}
HOME = Path(tests.proof.busmon.can.__file__).parent


class Backwards(Good):
    """Names its motors from the last to the first."""

    def __init__(self, port: can_world.VirtualPort, limits: CanLimits) -> None:
        super().__init__(port, limits)
        self.ids.reverse()


class LowerCase(Good):
    """Writes its digits small."""

    def exchange(self, text: bytes) -> None:
        lines = text.split(b"\r")
        super().exchange(b"\r".join(line[:1] + line[1:].lower() for line in lines))


class Probing(Good):
    """Asks an id that nobody has whether somebody acknowledges."""

    def connected(self) -> None:
        self.exchange(b"t7F080000000000000000\r")


class Damping(Good):
    """Soft for a moment: without stiffness the place in a command counts for nothing."""

    def armed(self) -> None:
        self.exchange(reply_frame(DAMIAO, packed(0x7FFF, kp=0)))
        self.hold(2)


class Pausing(Good):
    """Says nothing for 59 ms while it holds: short of a silence."""

    def armed(self) -> None:
        self.hold(2)
        self.port.until(self.port.now + 0.05)
        self.tick = self.port.now
        self.hold(2)


class Holding(Good):
    """Says nothing for 90 ms, and holds after it."""

    def armed(self) -> None:
        self.hold(2)
        self.port.until(self.port.now + 0.09)
        self.tick = self.port.now
        self.hold(4)


@pytest.mark.parametrize(
    "daemon",
    [Good, Cutting, Mirror, Killed, Reborn, Backwards, LowerCase, Probing, Damping, Pausing, Holding],
)
def test_a_daemon_that_does_everything_right_breaks_nothing(daemon: type[Good]) -> None:
    port = can_world.VirtualPort()
    daemon(port, can_world.LIMITS).live()
    assert not port.monitor.violations, "\n".join(map(str, port.monitor.violations[:5]))
    assert port.monitor.sent_packets > 60
    assert port.monitor.goal_packets > 50 or daemon is Mirror


@pytest.mark.parametrize("evil", EVILS, ids=lambda evil: evil.name)
def test_a_daemon_that_does_one_thing_wrong_is_caught_by_that_rule_and_no_other(evil: Evil[Good]) -> None:
    monitor = can_world.tried(evil.daemon)
    assert {violation.rule for violation in monitor.violations} == {evil.rule}, "\n".join(
        map(str, monitor.violations[:5])
    )


def test_every_rule_has_daemons_that_break_it() -> None:
    assert {evil.rule for evil in EVILS} == RULES
    assert len(EVILS) >= 60
    assert len({evil.name for evil in EVILS}) == len(EVILS)


def test_a_mirror_without_mode_reports_is_recognised_by_its_monitor() -> None:
    port = can_world.VirtualPort(writes=False)
    good = Good(port, can_world.LIMITS)
    good.connect()
    port.write(good.switch(CUBEMARS, True))
    assert [violation.rule for violation in port.monitor.violations] == ["W10"]


# ------------------------------------------------------------------------------------------- the proof proved


PLACES = accusations(HOME)


# The fast tests take the first accusation, `make check` takes all.
@pytest.mark.parametrize("place", fast_cases(PLACES, PLACES[:1]), ids=map(str, PLACES))
def test_without_any_one_accusation_some_daemon_goes_free(place: Accusation) -> None:
    # The rules of goals share one line.
    likely = [rule for rule in RULES if f'"{rule}"' in place.text] or ["W3", "W4"]
    for evil in sorted(EVILS, key=lambda evil: evil.rule not in likely):
        tried = can_world.tried(evil.daemon, without(CanMonitor, place))
        if {each.rule for each in tried.violations} != {evil.rule}:
            return
    pytest.fail(f"no wrong daemon needs {place.text}")


def test_the_monitor_shares_nothing_with_what_it_watches() -> None:
    for path in HOME.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [each.name for each in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not any(name.startswith("twind") for name in names), path
