"""Replay of a measured motion through the simulation, restarted from the measured state each second.

One second is several times the settling time of a servo, so a wrong model shows in full; without restarts
an error early in a window, or of the base, would grow into all that follows. Errors of all segments of a
window (ten seconds) are pooled, so that a figure hangs on no single pose.
"""

import numpy as np

from twind.gap.gap_figures import JointGap, joint_gaps
from twind.gap.motion_samples import MotionSamples
from twind.robot.arrays import Floats
from twind.twin.binding import Binding
from twind.twin.simulation import Simulation, hush

SEGMENT = 1.0  # s from one restart to the next
WINDOW = 10.0  # s of a sliding window
PAST = 0.3  # s of goals before a restart, for delayed servos
LONGEST_GAP = 0.05  # s between two samples: a longer one is a hole, over which nothing is simulated


class GapReplay:
    """Simulates what a robot of this model would have done; one per process and control period."""

    def __init__(self, binding: Binding, period: float) -> None:
        """`period`: s between two goals of the control loop."""
        hush()
        self._simulation = Simulation(binding, period)
        self._period = period

    def gaps(self, measured: MotionSamples) -> list[JointGap]:
        """Return the figures of each joint over all of `measured`."""
        even = resample(measured, self._period)
        return joint_gaps(even, self.simulate(even))

    def simulate(self, measured: MotionSamples) -> MotionSamples:
        """Return the simulated motion at the times of `measured`, which are one period apart.

        NaN in segments that cannot be simulated: a position of a joint is unknown.
        """
        length = max(1, round(SEGMENT / self._period))
        made = np.full((3, *measured.position.shape), np.nan)
        for first in range(0, len(measured.time) - 1, length):
            self._segment(measured, first, min(first + length, len(measured.time) - 1), made)
        return MotionSamples(measured.names, measured.time, measured.goal, made[0], made[1], made[2])

    def _segment(self, measured: MotionSamples, first: int, last: int, made: Floats) -> None:
        """Simulate from sample `first`; fill the samples after it, up to and with `last`.

        A joint without a goal is held where it was measured, and gets no figure.
        """
        position = measured.position[first : last + 1]
        goal = measured.goal[first : last + 1]
        if not np.isfinite(position).all():
            return
        free = ~np.isfinite(goal)
        goal = np.where(free, position, goal)
        begin = max(0, first - round(PAST / self._period))
        before = measured.goal[begin:first]
        past = np.where(np.isfinite(before), before, goal[0])
        velocity = np.nan_to_num(measured.velocity[first])
        self._simulation.begin(position[0], velocity, np.concatenate([past, goal[:1]]))
        resets = self._simulation.resets
        for row in range(first + 1, last + 1):
            self._simulation.step(goal[row - 1 - first])
            state = self._simulation.state(float(measured.time[row]))
            made[:, row] = state.position, state.velocity, state.effort
        if self._simulation.resets != resets:
            made[:, first + 1 : last + 1] = np.nan


def resample(samples: MotionSamples, period: float) -> MotionSamples:
    """Return the samples one `period` apart, interpolated; NaN in holes longer than `LONGEST_GAP`."""
    time = samples.time
    if len(time) < 2:
        return samples
    even = time[0] + period * np.arange(int((time[-1] - time[0]) / period + 1e-6) + 1)
    after = np.clip(np.searchsorted(time, even, "left"), 1, len(time) - 1)
    hole = time[after] - time[after - 1] > LONGEST_GAP
    share = ((even - time[after - 1]) / (time[after] - time[after - 1]))[:, None]

    def between(values: Floats) -> Floats:
        found: Floats = values[after - 1] * (1.0 - share) + values[after] * share
        exact = np.isclose(share, 1.0) | np.isclose(share, 0.0)  # the other neighbour may be NaN
        found = np.where(exact, values[after - 1 + np.round(share[:, 0]).astype(int)], found)
        found[hole] = np.nan
        return found

    return MotionSamples(
        names=samples.names,
        time=even,
        goal=between(samples.goal),
        position=between(samples.position),
        velocity=between(samples.velocity),
        effort=between(samples.effort),
        supply=None if samples.supply is None else between(samples.supply),
    )
