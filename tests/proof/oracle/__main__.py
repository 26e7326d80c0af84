"""`make oracle [N=…] [SEED=…]`: does the gate ever accept what an independent, slow oracle refuses (G1)?

Prints what was asked, what was accepted, and every disagreement with the seed that makes it again
(`--seed S --first I -n 1`). A false accept fails; false refusals are counted.
"""

import argparse
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from tests.proof.oracle.dense import excess
from tests.proof.oracle.draws import Question, question
from tests.support import gate_rig as w
from twind.robot.finding import ReasonCode
from twind.safety.gate import GateResult, check

ROUNDING = 1e-9  # of the bound's own size: both sides compute in doubles
EXACT = 25  # every so many accepted paths are judged in rationals altogether
CLEAR = 1e-6  # a path this far inside every rule ought not to be refused
STEP = 250  # questions of one piece of work
CURVE = (ReasonCode.POS_LIMIT, ReasonCode.VEL_LIMIT, ReasonCode.ACC_LIMIT, ReasonCode.BRAKE_DISTANCE)


@dataclass
class Tally:
    """Counts of a run. Disagreements as (number of the question, words)."""

    asked: int = 0
    accepted: int = 0
    exact: int = 0
    changed: Counter[str] = field(default_factory=Counter)
    refused: Counter[str] = field(default_factory=Counter)
    false_accepts: list[tuple[int, str]] = field(default_factory=list)
    false_refusals: list[tuple[int, str]] = field(default_factory=list)

    def add(self, other: "Tally") -> None:
        """Takes in what another piece of work saw."""
        self.asked += other.asked
        self.accepted += other.accepted
        self.exact += other.exact
        self.changed += other.changed
        self.refused += other.refused
        self.false_accepts += other.false_accepts
        self.false_refusals += other.false_refusals


def judged(asked: Question) -> GateResult:
    """The gate's answer."""
    snapshot = w.snapshot(len(asked.limit.lower), reference=asked.before)
    return check(asked.path, snapshot, asked.limit, asked.demand, w.TH)


def broken(asked: Question, answer: GateResult, exactly: bool) -> list[str]:
    """Violations that the oracle finds in a path that the gate accepted."""
    found = [
        f"{code} by {amount:.3g}"
        for code, amount in excess(answer.path, asked.before, asked.limit).items()
        if amount > ROUNDING * _size(code, asked)
    ]
    if exactly:
        found += [f"{code}, exactly" for code in w.oracle_faults(answer.path, asked.before, asked.limit, 64)]
    return found + _estranged(asked, answer)


def _size(code: ReasonCode, asked: Question) -> float:
    return float(np.max(asked.limit.acceleration)) if code is ReasonCode.ACC_LIMIT else 1.0


def _estranged(asked: Question, answer: GateResult) -> list[str]:
    """Check that the path that runs is the requested one: same places and rhythm, slower or with a ramp."""
    told = {finding.code: finding.value for finding in answer.verdict.changes}
    k = len(asked.path.time)
    path = answer.path
    factor = told.get(ReasonCode.RETIMED) or 1.0
    same = (
        len(path.time) == k + (ReasonCode.STOP_APPENDED in told)
        and np.array_equal(path.position[:k], asked.path.position)
        and np.allclose(path.time[:k], asked.path.time * factor, rtol=1e-12, atol=0.0)
        and factor >= 1.0
        and (path.velocity is None or np.allclose(path.velocity[:k] * factor, asked.path.velocity, rtol=1e-9))
        and set(told) <= {ReasonCode.RETIMED, ReasonCode.STOP_APPENDED}
    )
    return [] if same else ["not the path that was asked for"]


def harmless(asked: Question, answer: GateResult) -> bool:
    """The oracle sees the path as asked well inside every rule, though the gate refused it."""
    if asked.demand.append_stop or any(f.code not in CURVE for f in answer.verdict.refusals):
        return False
    return all(
        amount < -CLEAR * _size(code, asked)
        for code, amount in excess(asked.path, asked.before, asked.limit).items()
    )


def work(seed: int, first: int, last: int) -> Tally:
    """Questions first..last-1 of a seed."""
    seen = Tally()
    for number in range(first, last):
        asked = question(np.random.default_rng((seed, number)))
        answer = judged(asked)
        seen.asked += 1
        seen.refused.update({str(finding.code) for finding in answer.verdict.refusals})
        if answer.verdict.accepted:
            seen.accepted += 1
            seen.changed.update(str(finding.code) for finding in answer.verdict.changes)
            exactly = seen.accepted % EXACT == 1 or last - first < EXACT
            seen.exact += exactly
            seen.false_accepts += [(number, words) for words in broken(asked, answer, exactly)]
        elif harmless(asked, answer):
            codes = ", ".join(str(finding.code) for finding in answer.verdict.refusals)
            seen.false_refusals.append((number, codes))
    return seen


def main(arguments: list[str]) -> int:
    """Exit code 0: nothing was accepted that the oracle refuses."""
    parser = argparse.ArgumentParser(prog="make oracle", description=__doc__)
    parser.add_argument("-n", type=int, default=1000, help="trajectories")
    parser.add_argument("--seed", type=int, default=4)
    parser.add_argument("--first", type=int, default=0, help="number of the first one")
    asked = parser.parse_args(arguments)
    begun = time.monotonic()
    seen = Tally()
    end = asked.first + asked.n
    starts = range(asked.first, end, STEP)
    with ProcessPoolExecutor() as pool:
        seeds = [asked.seed] * len(starts)
        for tally in pool.map(work, seeds, starts, [min(start + STEP, end) for start in starts]):
            seen.add(tally)
    took = time.monotonic() - begun
    print(f"seed {asked.seed}: {seen.asked} trajectories in {took:.0f} s, {seen.accepted} accepted, of those")
    print(
        f"  {seen.exact} looked at in rationals; changed {dict(seen.changed)}; refused {dict(seen.refused)}"
    )
    print(f"  {len(seen.false_accepts)} false accepts, {len(seen.false_refusals)} false refusals")
    print(f"  next FIRST={end}")
    for number, words in seen.false_accepts[:20]:
        print(f"  FALSE ACCEPT of number {number}: {words}")
    for number, words in seen.false_refusals[:20]:
        print(f"  false refusal of number {number}: {words}")
    return int(bool(seen.false_accepts) or not seen.accepted)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
