"""Report of one recording: what was written, what was changed for the gate, and the next command. Pure."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twind.client.errors import finding_lines
from twind.ctl.hint_options import HintOptions
from twind.ctl.teaching.hand_recorder import GAP, HandRecorder
from twind.ctl.teaching.taught_motion import TaughtMotion, VerdictMessage
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode


@dataclass(frozen=True, slots=True)
class TeachOutcome:
    """A motion that was written to `path`."""

    motion: TaughtMotion
    verdict: VerdictMessage | None  # of the gate; None: it was not asked
    recorder: HandRecorder
    path: Path
    mode: str = Mode.LIVE  # of the daemon while it was taught

    def as_sent(self) -> dict[str, Any]:
        """Return it as JSON."""
        worst = self.motion.deviation()
        return {
            "path": str(self.path),
            "seconds": self.recorder.seconds,
            "points": len(self.motion.points.time),
            "lead": self.motion.lead,
            "deviation": worst.size,
            "deviation_joint": self.motion.joints[worst.joint],
            "added": self.motion.added,
            "slowest": self.motion.slowest,
            "slowed_for": [f"{code} {text}" for (code, _), text in self.motion.reasons.items()],
            "clipped": self.motion.clipped(),
            "bridged": self.recorder.bridged,
            "ended": self.recorder.ended or None,
            "verdict": self.verdict,
        }

    def lines(self, hint: HintOptions, name: str) -> list[str]:
        """Return it as text; `name`: what `play` is given."""
        motion = self.motion
        worst = motion.deviation()
        count = len(motion.points.time)
        where = f"{motion.joints[worst.joint]} at {worst.time:.2f} s"
        lines = [
            f"{self.recorder.seconds:.2f} s of {len(motion.joints)} joints: {count} points in {self.path}",
            f"largest deviation from the hand's path: {worst.size:.4f} rad ({where})",
        ]
        if self.recorder.ended:
            lines.append(f"the recording ended: {self.recorder.ended}")
        if self.recorder.bridged:
            lines.append(f"gaps below {GAP:g} s that were bridged: {self.recorder.bridged}")
        for joint, by in motion.clipped().items():
            lines.append(f"moved into the limits: {joint} by up to {by:.4f} rad")
        if motion.reasons:
            lines.append(f"slowed down by {motion.added:.2f} s, at most {motion.slowest:.1f} times, for")
            lines += [f"  {code} {text}" for (code, _), text in motion.reasons.items()]
        if self.verdict is None:
            lines.append("the gate has not judged it: twindctl check trajectory does")
        else:
            refusals = self.verdict["refusals"]
            lines += finding_lines(refusals, "play will be refused:")
            if any(each["code"] == ReasonCode.TOO_MANY_POINTS for each in refusals):
                lines.append("teach less at a time, guide more slowly, or permit more with --bound")
        lines.append(f"its start is reached in {motion.lead:.1f} s")
        about_now = () if self.verdict is None else (each["code"] for each in self.verdict["warnings"])
        first = "disarm, twindctl " if ReasonCode.JOINT_LIMP in about_now else ""
        if self.mode != Mode.LIVE:
            first = "mode live, twindctl "
        lines.append(hint.command(f"next: twindctl {first}arm, then twindctl play {name} --approach"))
        return lines
