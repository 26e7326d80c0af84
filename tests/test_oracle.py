"""The gate against the oracle of `make oracle`, in short; and whether the oracle sees what is planted."""

from dataclasses import replace

import numpy as np
import pytest
from oracle.__main__ import broken, judged, work
from oracle.draws import Question, question

from twind.robot.finding import Code, Verdict


def test_the_gate_accepts_nothing_that_the_oracle_refuses() -> None:
    seen = work(4, 0, 250)
    assert seen.false_accepts == []
    assert seen.accepted > 60 and seen.exact >= 3
    assert {Code.RETIMED, Code.STOP_APPENDED} <= set(seen.changed)
    assert {"POS_LIMIT", "VEL_LIMIT", "ACC_LIMIT", "BRAKE_DISTANCE", "START_JUMP"} <= set(seen.refused)
    assert len(seen.false_refusals) <= seen.asked // 100


def planted() -> dict[Code, Question]:
    """A refused question for each rule of the curve, which a blind gate would let in."""
    found: dict[Code, Question] = {}
    for number in range(400):
        asked = question(np.random.default_rng((4, number)))
        refusals = judged(asked).verdict.refusals
        clearly = all(abs(finding.value - finding.bound) > 1e-6 for finding in refusals)
        if clearly and len({finding.code for finding in refusals}) == 1:
            found.setdefault(refusals[0].code, asked)
    return found


PLANTED = planted()


@pytest.mark.parametrize(
    "code", [Code.POS_LIMIT, Code.VEL_LIMIT, Code.ACC_LIMIT, Code.START_JUMP, Code.END_NOT_AT_REST]
)
def test_the_oracle_sees_what_a_blind_gate_lets_in(code: Code) -> None:
    asked = PLANTED[code]
    blind = replace(judged(asked), verdict=Verdict(), path=asked.path)
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
