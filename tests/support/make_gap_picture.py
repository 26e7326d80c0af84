"""`make pictures`: docs/pictures/gap.png, the gap of the virtual arm koch before and after identification.

The daemon runs on virtual servos and a body in MuJoCo, under a fake clock. Takes two minutes of one core.
"""

import sys

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tests.support.gap_rig import LIFTING, PERIOD, identified_arm
from tests.support.make_pictures import FOLDER, MOST
from twind.gap.gap_figures import joint_gaps, total_gap
from twind.gap.gap_replay import GapReplay, resample

JOINT = "elbow_flex"
SHOWN = 20.0  # s
COLOURS = ("0.6", "#0072b2", "#d55e00")


def main() -> int:
    """Draw it, and print its figures; 1 where it is too large."""
    arm = identified_arm()
    runs = (
        ("before identification", arm.plain, arm.same),
        ("after identification", arm.known, arm.same),
        ("after, links 1.5 times as heavy", arm.known, arm.heavier),
    )
    made = Figure(figsize=(8.0, 5.0), dpi=100, layout="constrained")
    FigureCanvasAgg(made)
    angle, error, bars = made.subplots(3, 1, height_ratios=[1.0, 1.2, 1.0])
    for place, (title, binding, motion) in enumerate(runs):
        even = resample(motion, PERIOD)
        simulated = GapReplay(binding, PERIOD).simulate(even)
        gaps = joint_gaps(even, simulated)
        column = even.names.index(JOINT)
        rows = even.time < even.time[0] + SHOWN
        time = even.time[rows] - even.time[0]
        if place == 0:
            angle.plot(time, even.position[rows, column], "k", linewidth=1.0)
        off = 1e3 * (simulated.position - even.position)[rows, column]
        error.plot(time, off, color=COLOURS[place], linewidth=0.9, label=title)
        shares = {each.joint: each.position.unexplained for each in gaps if each.position}
        total = total_gap(gaps)
        assert total is not None and total.unexplained is not None
        heights = [100.0 * (shares[name] or 0.0) for name in LIFTING] + [100.0 * total.unexplained]
        bars.bar(np.arange(len(heights)) + 0.27 * (place - 1), heights, 0.25, color=COLOURS[place])
        print(f"{title}: rms {total.rms * 1e3:.2f} mrad, {total.nrmse_spread:.1%}, {total.unexplained:.1%}")
    angle.set_ylabel(f"{JOINT}\nmeasured (rad)", fontsize=8)
    error.set_ylabel("simulated less\nmeasured (mrad)", fontsize=8)
    error.set_xlabel("s", fontsize=8)
    error.legend(fontsize=7, ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0), frameon=False)
    bars.set_ylabel("unexplained (%)", fontsize=8)
    bars.set_xticks(range(len(LIFTING) + 1), [*LIFTING, "all joints"])
    for panel in (angle, error, bars):
        panel.grid(True, color="0.92", linewidth=0.6)
        panel.set_axisbelow(True)
        panel.tick_params(labelsize=7)
    out = FOLDER / "gap.png"
    made.savefig(out)
    print(f"{out.name}: {out.stat().st_size} bytes")
    return int(out.stat().st_size > MOST)


if __name__ == "__main__":
    sys.exit(main())
