"""What a calibration file keeps of a proof. Pure."""

from collections.abc import Mapping
from dataclasses import replace

from twind.config.calibration_file import Calibration, JointCalibration
from twind.config.section import Plain
from twind_calibration.proving.told import Verdict


def recorded(
    calibration: Calibration, verdicts: Mapping[str, Verdict], at: str
) -> tuple[Calibration, list[str], list[str]]:
    """With the proofs of `verdicts`, by entry: the calibration, whose proof is new, whose was taken away.

    What contradicts takes an earlier proof away. An eye replaces none that gravity gave.
    """
    joints = [_with(entry, verdicts.get(entry.name), at) for entry in calibration.joints]
    pairs = list(zip(calibration.joints, joints, strict=True))
    new = [after.name for before, after in pairs if after.proof not in (before.proof, None)]
    gone = [after.name for before, after in pairs if before.proof is not None and after.proof is None]
    return replace(calibration, joints=tuple(joints)), new, gone


def _with(entry: JointCalibration, verdict: Verdict | None, at: str) -> JointCalibration:
    if verdict is None or verdict.proof is None:
        return entry
    if not verdict.good:
        return replace(entry, proof=None)
    found: Plain = verdict.record(at)
    if found is None or (verdict.by_eye and _by_gravity(entry.proof)):
        return entry
    return replace(entry, proof=found)


def _by_gravity(proof: Plain) -> bool:
    return isinstance(proof, dict) and proof.get("sign") == "gravity"
