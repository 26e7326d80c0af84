"""The gate against the oracle of `make oracle`, in short; and whether the oracle sees what is planted."""

from dataclasses import replace
from math import nextafter

import numpy as np
import pytest

from tests.proof.oracle.__main__ import broken, judged, work
from tests.proof.oracle.dense import excess
from tests.proof.oracle.draws import question
from tests.support import gate_rig as w
from twind.robot.finding import ReasonCode, Verdict
from twind.robot.trajectory import Reference


@pytest.mark.slow
def test_the_gate_accepts_nothing_that_the_oracle_refuses() -> None:
    seen = work(4, 0, 250)
    assert seen.false_accepts == []
    assert seen.accepted > 60 and seen.exact >= 3
    assert {ReasonCode.RETIMED, ReasonCode.STOP_APPENDED} <= set(seen.changed)
    assert {"POS_LIMIT", "VEL_LIMIT", "ACC_LIMIT", "BRAKE_DISTANCE", "START_JUMP"} <= set(seen.refused)
    assert len(seen.false_refusals) <= seen.asked // 100


# Numbers of questions that the gate refuses for one rule of the curve alone, by more than rounding.
REFUSED = {
    ReasonCode.END_NOT_AT_REST: 3,
    ReasonCode.VEL_LIMIT: 10,
    ReasonCode.POS_LIMIT: 22,
    ReasonCode.ACC_LIMIT: 47,
    ReasonCode.START_JUMP: 163,
}


@pytest.mark.parametrize("code", REFUSED)
def test_the_oracle_sees_a_refused_path_that_a_blind_gate_accepts(code: ReasonCode) -> None:
    asked = question(np.random.default_rng((4, REFUSED[code])))
    answer = judged(asked)
    assert {finding.code for finding in answer.verdict.refusals} == {code}
    assert all(abs(finding.value - finding.bound) > 1e-6 for finding in answer.verdict.refusals)
    blind = replace(answer, verdict=Verdict(), path=asked.path)
    assert any(words.startswith(code) for words in broken(asked, blind, exactly=False))


def test_the_oracle_sees_a_path_that_is_not_the_one_that_was_asked() -> None:
    for number in range(50):
        asked = question(np.random.default_rng((4, number)))
        answer = judged(asked)
        if answer.verdict.accepted and len(asked.path.time) > 1:
            other = replace(answer, path=replace(answer.path, time=answer.path.time * 1.5))
            assert "not the path that was asked for" in broken(asked, other, exactly=False)
            return
    raise AssertionError("nothing was accepted")


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("entry", [None, 0.0, 0.05])
@pytest.mark.parametrize(("change", "rest"), [(0.0, True), (0.05, True), (0.0501, False), (0.9, False)])
def test_a_single_point_at_once_may_stop_what_counts_as_at_rest_and_nothing_else(
    sign: float, entry: float | None, change: float, rest: bool
) -> None:
    """The change takes no time: it is judged as a speed (ACC_LIMIT). An uncommanded joint keeps its own."""
    path = w.path([0.0], [[0.0, 0.0]], None if entry is None else [[sign * entry, 0.0]])
    path = replace(path, commanded=np.array([True, False]))
    running = (entry or 0.0) - (change - 1e-12 if rest else change)
    before = Reference(np.zeros(2), np.array([sign * running, 0.9]), np.zeros(2))
    limit = w.limits()
    assert (ReasonCode.ACC_LIMIT not in w.codes(w.ask(path, limit, before))) is rest
    assert (excess(path, before, limit)[ReasonCode.ACC_LIMIT] <= 0.0) is rest
    assert w.oracle_faults(path, before, limit) == (set() if rest else {ReasonCode.ACC_LIMIT})


def test_the_speed_that_counts_as_rest_is_the_last_one_a_single_point_may_stop() -> None:
    for speed, rest in ((0.05, True), (nextafter(0.05, 1.0), False)):
        for sign in (1.0, -1.0):
            before = Reference(np.zeros(1), np.array([sign * speed]), np.zeros(1))
            assert w.ask(w.path([0.0], [0.0]), w.limits(1), before).verdict.accepted is rest


@pytest.mark.parametrize("velocity", [None, 0.0])
def test_the_exact_oracle_sees_the_step_of_a_path_that_begins_at_once(velocity: float | None) -> None:
    """Over half of the first segment, as the gate counts it: 0.5 rad/s in half of 0.1 s is 10 rad/s²."""
    before = Reference(np.zeros(1), np.array([0.5]), np.zeros(1))
    rates = None if velocity is None else [velocity, velocity]
    path = w.path([0.0, 0.1], [0.0, 0.0], rates)
    for strongest, seen in ((10.0 + 1e-9, False), (10.0 - 1e-6, True)):
        limit = w.limits(1, acceleration=strongest)
        assert (ReasonCode.ACC_LIMIT in w.oracle_faults(path, before, limit)) is seen
        assert (ReasonCode.ACC_LIMIT in w.codes(w.ask(path, limit, before))) is seen
