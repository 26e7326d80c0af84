"""The monitor is proved by what it catches: each wrong daemon by its rule, the right ones by none."""

from pathlib import Path

import pytest

from tests.proof import busmon
from tests.proof.busmon.limits import Limits
from tests.proof.busmon.monitor import Monitor
from tests.proof.busmon.packet import make
from tests.proof.evil import world
from tests.proof.evil.accusations import Accusation, accusations, without
from tests.proof.evil.every import EVILS
from tests.proof.evil.good import Cutting, Good, Killed, Mirror, Reborn
from tests.proof.evil.registry import Evil
from tests.proof.evil.search import Seeker
from tests.support.examples import fast_cases

LIMITS = world.limits()
RULES = {f"W{number}" for number in range(1, 12)}


class Backwards(Good):
    """Names its servos from the last to the first."""

    def __init__(self, port: world.VirtualPort, limits: Limits) -> None:
        super().__init__(port, limits)
        self.ids.reverse()
        self.here = dict.fromkeys(self.ids, 0)


class Plain(Good):
    """Reads by plain sync reads: one status of each servo."""

    def ask(self, address: int, size: int, before: bytes = b"") -> dict[int, int]:
        ids = bytes(self.ids)
        params = address.to_bytes(2, "little") + size.to_bytes(2, "little") + ids
        self.port.write(before + make(254, 0x82, params))
        answer = self.port.read(len(ids) * (11 + size), 0.004)
        rows = [answer[at : at + 11 + size] for at in range(0, len(answer), 11 + size)]
        return {row[4]: int.from_bytes(row[9:-2], "little", signed=size == 4) for row in rows}


@pytest.mark.parametrize("daemon", [Good, Cutting, Mirror, Killed, Reborn, Backwards, Plain, Seeker])
def test_a_daemon_that_does_everything_right_breaks_nothing(daemon: type[Good]) -> None:
    port = world.VirtualPort(LIMITS)
    daemon(port, LIMITS).live()
    assert not port.monitor.violations, "\n".join(map(str, port.monitor.violations[:5]))
    assert port.monitor.sent_packets > 20


@pytest.mark.parametrize("evil", EVILS, ids=lambda evil: evil.name)
def test_a_daemon_that_does_one_thing_wrong_is_caught_by_that_rule_and_no_other(evil: Evil[Good]) -> None:
    monitor = world.tried(evil.daemon, LIMITS)
    assert {violation.rule for violation in monitor.violations} == {evil.rule}, "\n".join(
        map(str, monitor.violations[:5])
    )


def test_every_rule_has_daemons_that_break_it() -> None:
    assert {evil.rule for evil in EVILS} == RULES
    assert len(EVILS) >= 30
    assert len({evil.name for evil in EVILS}) == len(EVILS)


def test_a_mirror_without_mode_reports_is_recognised_by_its_monitor() -> None:
    port = world.VirtualPort(LIMITS, writes=False)
    good = Good(port, LIMITS)
    good.connect()
    port.write(good.aim(good.present()))
    assert [violation.rule for violation in port.monitor.violations] == ["W10"]


# ------------------------------------------------------------------------------------------- the proof proved

# Needed by others than these daemons: words that come late, second holders of a port, the servos' clocks.
ELSEWHERE = {
    "self._broken(rule, time, id, text)": "tests/proof/busmon/test_busmon_rules.py",
    'self._broken("W5", self._goal_at': "tests/proof/busmon/test_busmon_rules.py",
    'self._broken("W9", now, None, f"a second talker': "tests/end_to_end/wired/test_evil_daemons_live.py",
    'self._broken("W11", now, id, f"its watchdog tripped': "tests/proof/busmon/test_busmon_rules.py",
}


ACCUSATIONS = accusations(Path(busmon.__file__).parent)
PLACES = [place for place in ACCUSATIONS if not place.text.startswith(tuple(ELSEWHERE))]


def test_the_places_that_accuse_are_known() -> None:
    assert len(ACCUSATIONS) == len(PLACES) + len(ELSEWHERE) >= 20


# The fast tests take the first accusation, `make check` takes all.
@pytest.mark.parametrize("place", fast_cases(PLACES, PLACES[:1]), ids=map(str, PLACES))
def test_without_any_one_accusation_some_daemon_goes_free(place: Accusation) -> None:
    """A monitor that lacks one lets a wrong daemon pass, or names another rule."""
    for evil in sorted(EVILS, key=lambda evil: f'"{evil.rule}"' not in place.text):
        tried = world.tried(evil.daemon, LIMITS, without(Monitor, place))
        if {each.rule for each in tried.violations} != {evil.rule}:
            return
    pytest.fail(f"no wrong daemon needs {place.text}")
