"""A proof is of the zero that moved the joint: a file that holds another one by then gets none."""

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest

from tests.support.proof_verdicts import CONTRADICTED, verdict
from twind.command_line.verb import Rejected
from twind.config.calibration_file import Calibration, load_calibration
from twind.config.robot_file import load_robot
from twind.virtual.virtual_robot_spec import calibration, make_spec
from twind_calibration.calibrating.file_ownership import save
from twind_calibration.proving.proof_records import in_force, measurement_records, unlike
from twind_calibration.proving.prove_command import ProofSession
from twind_calibration.wiggling.posed_model import PosedModel
from twind_drivers.clock import FakeClock

H24 = load_robot("h24")
MADE = calibration(make_spec(H24))
BODY = PosedModel(H24)


def as_reported(made: Calibration) -> Any:
    """As GetRobot tells it: through JSON."""
    return msgspec.json.decode(msgspec.json.encode(msgspec.to_builtins(made, enc_hook=str)))


def with_zero(made: Calibration, name: str, by: int) -> Calibration:
    joints = [replace(each, zero_ticks=each.zero_ticks + by * (each.name == name)) for each in made.joints]
    return replace(made, joints=tuple(joints))


def with_proof(made: Calibration, name: str) -> Calibration:
    proof = {"sign": "gravity", "slope_ratio": 0.94}
    joints = [replace(each, proof=proof if each.name == name else each.proof) for each in made.joints]
    return replace(made, joints=tuple(joints))


class Daemon:
    """Goes by one calibration, whatever its file says by now."""

    def __init__(self, path: Path, goes_by: Calibration | None) -> None:
        self._path = path
        self._goes_by = goes_by

    def call(self, method: str) -> Mapping[str, Any]:
        if method == "GetParameters":
            return {"parameters": {"calibration": str(self._path), "rate_hz": 100.0}}
        assert method == "GetRobot"
        robot = {"path": str(H24.path), "text_sha256": H24.text_sha256}
        return {
            "robot": robot,
            "calibration": None if self._goes_by is None else as_reported(self._goes_by),
            "mjcf": BODY.mjcf,
        }


def session(path: Path, goes_by: Calibration | None = MADE) -> ProofSession:
    options = argparse.Namespace(
        calibration=None, joints=[], pose=None, bends=[], base="back", socket=None, json=True
    )
    client: Any = Daemon(path, goes_by)
    return ProofSession(options, client, FakeClock())


@pytest.fixture
def path(tmp_path: Path) -> Path:
    save(MADE, tmp_path / "one.yaml")
    return tmp_path / "one.yaml"


def proofs(path: Path) -> list[str]:
    return [each.name for each in load_calibration(path, H24).joints if each.proof is not None]


def test_entries_compare_in_the_daemons_format_and_proofs_are_no_difference() -> None:
    force = in_force(as_reported(MADE))
    assert unlike(measurement_records(MADE), force) == []
    assert unlike(measurement_records(with_proof(MADE, "l_knee")), force) == []
    assert unlike(measurement_records(MADE), in_force(as_reported(with_proof(MADE, "l_knee")))) == []
    assert unlike(measurement_records(with_zero(MADE, "l_knee", 1)), force) == ["l_knee"]
    fewer = replace(MADE, joints=MADE.joints[1:])
    assert unlike(measurement_records(fewer), force) == [MADE.joints[0].name]
    assert unlike(measurement_records(MADE), in_force(as_reported(fewer))) == [MADE.joints[0].name]
    assert len(unlike(measurement_records(None), force)) == len(MADE.joints)
    assert unlike(measurement_records(None), in_force(None)) == []


def test_nothing_moves_where_the_daemon_goes_by_another_zero_than_its_file(path: Path) -> None:
    session(path)
    save(with_zero(MADE, "l_hip_pitch", 300), path)
    with pytest.raises(Rejected, match=r"not what the daemon goes by: l_hip_pitch .*systemctl restart"):
        session(path)
    path.unlink()
    with pytest.raises(Rejected, match="not what the daemon goes by"):
        session(path)


def test_a_zero_that_was_measured_meanwhile_gets_no_proof_and_the_others_get_theirs(path: Path) -> None:
    one = session(path)
    save(with_zero(MADE, "l_hip_pitch", 300), path)
    with pytest.raises(Rejected, match="l_hip_pitch calibrated anew meanwhile"):
        one.keep([verdict(joint="l_hip_pitch"), verdict(joint="l_knee")])
    assert proofs(path) == ["l_knee"]
    zero = MADE.by_name["l_hip_pitch"].zero_ticks
    assert load_calibration(path, H24).by_name["l_hip_pitch"].zero_ticks == zero + 300


def test_a_contradiction_of_an_earlier_zero_keeps_the_proof_of_a_later_zero(path: Path) -> None:
    one = session(path)
    save(with_proof(with_zero(MADE, "l_knee", 5), "l_knee"), path)
    with pytest.raises(Rejected, match="l_knee calibrated anew"):
        one.keep([CONTRADICTED])
    assert proofs(path) == ["l_knee"]


def test_a_calibration_file_removed_during_a_proof_is_reported(path: Path) -> None:
    one = session(path)
    path.unlink()
    with pytest.raises(Rejected, match="l_knee calibrated anew meanwhile"):
        one.keep([verdict()])
    one.keep([])
    assert not path.exists()
