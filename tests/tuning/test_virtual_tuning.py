"""Tuning of virtual servos that move a body, on real bytes under a fake clock."""

from pathlib import Path

import pytest

from tests.support.tuning_rig import RigBench
from twind.tuning.gain_search import GainSearch
from twind.tuning.gain_tuning import TuningResult, tune

pytestmark = pytest.mark.slow

BOUND = 0.1


def tuned(folder: Path, gains: str, joint: str) -> TuningResult:
    bench = RigBench(folder, gains)
    try:
        found = tune(bench, [joint], GainSearch(bench.file, bench.limits, BOUND), 8)
        assert bench.gains_of("xl430") == bench.file
        assert bench.rig.loop.condition.state == "connected"
    finally:
        bench.rig.close()
    return found


@pytest.mark.parametrize(
    ("gains", "joint"),
    [("{p: 200, i: 0, d: 0}", "shoulder_pan"), ("{p: 800, i: 10000, d: 0}", "shoulder_lift")],
)
def test_soft_and_hot_gains_settle_sooner_within_the_bound_of_overshoot(
    tmp_path: Path, gains: str, joint: str
) -> None:
    found = tuned(tmp_path, gains, joint)
    before = found.tries[0].response
    assert before is not None and found.proposal is not None
    after = found.proposal.response
    assert after is not None
    assert after.settling < 0.7 * before.settling
    assert after.overshoot <= BOUND and not after.rings
