"""Records of proofs in a calibration file, and their comparison with the calibration in force. Pure."""

import json
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

from twind.config.calibration_file import Calibration, JointCalibration
from twind.config.config_reader import Plain
from twind_calibration.proving.proof_report import ProofVerdict


def measurement_records(calibration: Calibration | None) -> dict[str, object]:
    """Return the measurements of each actuator in JSON form: its entry without the proof."""
    joints = () if calibration is None else calibration.joints
    return {each.name: json.loads(json.dumps(asdict(replace(each, proof=None)))) for each in joints}


def in_force(record: Any) -> dict[str, object]:
    """Likewise of what the daemon goes by: `calibration` of GetRobot."""
    return {} if record is None else {each["name"]: {**each, "proof": None} for each in record["joints"]}


def unlike(one: Mapping[str, object], other: Mapping[str, object]) -> list[str]:
    """The actuators that were measured otherwise, or in one of the two alone."""
    return [name for name in {**one, **other} if one.get(name) != other.get(name)]


def with_proofs(
    calibration: Calibration, verdicts: Mapping[str, ProofVerdict], at: str
) -> tuple[Calibration, list[str], list[str]]:
    """Add the proofs of `verdicts`; return the calibration, names with a new proof, names without it now.

    What contradicts takes an earlier proof away. An eye replaces none that gravity gave.
    """
    joints = [_with(entry, verdicts.get(entry.name), at) for entry in calibration.joints]
    pairs = list(zip(calibration.joints, joints, strict=True))
    new = [after.name for before, after in pairs if after.proof not in (before.proof, None)]
    gone = [after.name for before, after in pairs if before.proof is not None and after.proof is None]
    return replace(calibration, joints=tuple(joints)), new, gone


def _with(entry: JointCalibration, verdict: ProofVerdict | None, at: str) -> JointCalibration:
    if verdict is None or verdict.proof is None:
        return entry
    if not verdict.is_consistent:
        return replace(entry, proof=None)
    found: Plain = verdict.record(at)
    if found is None or (verdict.by_eye and _by_gravity(entry.proof)):
        return entry
    return replace(entry, proof=found)


def _by_gravity(proof: Plain) -> bool:
    return isinstance(proof, dict) and proof.get("sign") == "gravity"
