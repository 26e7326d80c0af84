"""Wrong daemons as processes see them: real ports, the relay between, real time."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from tests.proof.evil import ends, goals, live, packets
from tests.proof.evil.good import Good, Mirror

TRIES = 4  # of a life in which the machine did not keep pace

CHOSEN = {
    "W1": goals.BeyondLower,
    "W2": packets.GoalVelocity,
    "W3": goals.TwoCountsTooFast,
    "W4": goals.GoalNotPresent,
    "W5": goals.GoalWhileConnected,
    "W6": ends.GoesOn,
    "W7": ends.WatchdogNotReadBack,
    "W8": packets.BadCrc,
    "W10": ends.MirrorWritesGoal,
    "W11": ends.ReaderOutlivesItsWriter,
}


def lived(daemon: type[Good]) -> tuple[int, str]:
    """The relay's exit code and words of a life that the machine did not disturb."""
    for _ in range(TRIES):
        with tempfile.TemporaryDirectory(prefix="twind-evil-") as name, live.servos(Path(name)) as port:
            code, said, kept = live.tried(daemon, Path(name), port)
        if kept:
            return code, said
    pytest.skip(
        f"{TRIES} lives, each kept from running for more than {live.LATE} s: this machine is too busy"
    )


# A wrong goal, and a process that outlives the other. In virtual time the monitor is tried with every daemon
# (tests/proof/evil). The others of these take half a minute together.
SHORT = {"W3": (), "W11": pytest.mark.slow}


@pytest.mark.parametrize(
    "rule", [pytest.param(rule, marks=SHORT.get(rule, pytest.mark.campaign)) for rule in CHOSEN]
)
def test_the_relay_ends_with_1_and_names_the_rule(rule: str) -> None:
    code, said = lived(CHOSEN[rule])
    assert code == 1, said[-500:]
    first = next(line for line in said.splitlines() if line.startswith("violation"))
    assert f" {rule} " in first or f" {rule}:" in first, said[:500]
    packets_shown = [line for line in said.splitlines() if line.startswith("  ")]
    assert 1 <= len(packets_shown) <= 200
    print(first)


@pytest.mark.slow
@pytest.mark.parametrize("daemon", [Good, Mirror])
def test_the_relay_ends_with_0_for_who_does_everything_right(daemon: type[Good]) -> None:
    code, said = lived(daemon)
    assert code == 0, said[:3000]


class BesideAnother(Mirror):
    """Another process opens the port that this one holds, and says nothing yet."""

    def connected(self) -> None:
        program = "import os, sys, time; os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY); time.sleep(30)"
        path = os.ttyname(self.port.fd)  # type: ignore[attr-defined]
        with subprocess.Popen([sys.executable, "-c", program, path]) as other:
            try:
                self.idle(800)
            finally:
                other.kill()


@pytest.mark.slow
def test_a_process_that_opens_a_used_port_is_detected_before_it_sends() -> None:
    code, said = lived(BesideAnother)
    assert code == 1, said[-500:]
    assert "W9: a second talker" in said
