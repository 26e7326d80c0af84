"""Report and record of a proof, and the planned base pose."""

import json
from dataclasses import replace
from math import radians
from pathlib import Path

import numpy as np
import pytest

from tests.support.proof_verdicts import CONTRADICTED, H24, verdict
from tests.support.transmission_robot_file import linked
from twind.command_line.verb import Rejected, UsageError
from twind.config.calibration_file import Calibration, dump_calibration, read_calibration
from twind.ctl.ctl_main import main
from twind.virtual.virtual_robot_spec import calibration, make_spec
from twind_calibration.calibrating.file_ownership import save
from twind_calibration.proving.proof_plan import best
from twind_calibration.proving.proof_pose_motion import wanted_pose
from twind_calibration.proving.proof_records import with_proofs
from twind_calibration.proving.proof_report import ProofVerdict
from twind_calibration.proving.sign_proof import ContradictionKind, SignProofStatus
from twind_calibration.wiggling.joint_move import MoveResult
from twind_calibration.wiggling.move_evidence import EncoderResponse
from twind_calibration.wiggling.posed_model import PosedModel

MADE = calibration(make_spec(H24))
AT = "2026-11-22T09:00:00Z"
Captured = pytest.CaptureFixture[str]


# ------------------------------------------------------------------------------------- the verdict


@pytest.mark.parametrize(
    "proof", [SignProofStatus.PROVED, SignProofStatus.PLAUSIBLE, SignProofStatus.UNOBSERVABLE]
)
def test_an_eye_confirms_what_gravity_does_not_show_and_contradicts_what_it_does(
    proof: SignProofStatus,
) -> None:
    assert verdict(proof).proof is proof
    assert verdict(proof, confirmed=True).proof is (
        proof if proof is SignProofStatus.PROVED else SignProofStatus.CONFIRMED
    )
    told = verdict(proof, confirmed=False)
    assert (told.proof, told.against, told.is_consistent) == (
        SignProofStatus.CONTRADICTED,
        ContradictionKind.EYE,
        False,
    )


def test_an_eye_does_not_make_good_what_gravity_contradicts() -> None:
    assert (
        verdict(SignProofStatus.CONTRADICTED, ContradictionKind.SIGN, confirmed=True).proof
        is SignProofStatus.CONTRADICTED
    )


@pytest.mark.parametrize(
    "odd",
    [
        verdict(motion=EncoderResponse.STILL),
        verdict(motion=EncoderResponse.BACKWARDS),
        verdict(others=(3,)),
        verdict(off=0.2),
    ],
)
def test_a_joint_that_does_not_go_alone_where_it_is_sent_is_contradicted_whatever_its_load(
    odd: ProofVerdict,
) -> None:
    assert (odd.proof, odd.against, odd.record(AT)) == (
        SignProofStatus.CONTRADICTED,
        ContradictionKind.MOTION,
        None,
    )


@pytest.mark.parametrize(
    "nothing",
    [
        verdict(gone=MoveResult(0.3, refused=("POS_LIMIT",))),
        verdict(gone=MoveResult(0.3, ended=("cancelled",), left=0.1)),
        verdict(motion=EncoderResponse.UNHEARD),
    ],
)
def test_an_unmeasured_joint_is_neither_consistent_nor_contradicted(nothing: ProofVerdict) -> None:
    assert (nothing.proof, nothing.is_consistent, nothing.record(AT)) == (None, False, None)
    assert nothing.lines()[0].startswith("not done     l_knee (main id 16)")


def test_every_proof_verdict_has_a_text_and_a_json_form() -> None:
    for one, word in (
        (
            verdict(),
            "proved       l_knee (main id 16): slope +0.94, off by 0.01 N·m, with the other sign 0.80",
        ),
        (
            verdict(SignProofStatus.UNOBSERVABLE),
            "unobservable l_knee (main id 16): here a wrong sign is 0.85 N·m off",
        ),
        (CONTRADICTED, "contradicted l_knee"),
        (verdict(SignProofStatus.UNOBSERVABLE, confirmed=True), "confirmed    l_knee"),
    ):
        assert one.lines()[0].startswith(word)
        assert json.loads(json.dumps(one.to_json()))["proof"] == one.proof
    said = "\n".join(CONTRADICTED.lines())
    assert "Before the sign is touched" in said and "servo of l_knee" in said
    assert "zero off by +0.04 ± 0.10 rad" in verdict().lines()[0]


# ------------------------------------------------------------------------------------- the file


def proof_of(made: Calibration, name: str = "l_knee") -> object:
    return made.by_name[name].proof


def test_a_proof_is_kept_and_reads_back_as_it_was_written() -> None:
    after, new, gone = with_proofs(MADE, {"l_knee": verdict()}, AT)
    assert (new, gone) == (["l_knee"], [])
    again = read_calibration(dump_calibration(after), "file", H24)
    assert proof_of(again) == {
        "sign": "gravity",
        "base_pose": "back",
        "slope_ratio": 0.94,
        "offset_residual_rad": 0.04,
        "offset_unsure_rad": 0.1,
        "at": AT,
    }
    assert replace(after, joints=MADE.joints) == MADE, "nothing but the proofs differs"
    assert [each.name for each in after.joints if each.proof] == ["l_knee"]


@pytest.mark.parametrize(
    "other",
    [
        verdict(SignProofStatus.PLAUSIBLE),
        verdict(SignProofStatus.UNOBSERVABLE),
        verdict(gone=MoveResult(0.3, refused=("POS_LIMIT",))),
    ],
)
def test_an_inconclusive_proof_is_not_kept_and_leaves_an_earlier_proof(other: ProofVerdict) -> None:
    assert with_proofs(MADE, {"l_knee": other}, AT) == (MADE, [], [])
    before, _, _ = with_proofs(MADE, {"l_knee": verdict()}, AT)
    assert with_proofs(before, {"l_knee": other}, "2027-01-01T00:00:00Z") == (before, [], [])


def test_a_contradiction_is_not_kept_and_removes_an_earlier_proof() -> None:
    assert with_proofs(MADE, {"l_knee": CONTRADICTED}, AT) == (MADE, [], [])
    before, _, _ = with_proofs(MADE, {"l_knee": verdict()}, AT)
    after, new, gone = with_proofs(before, {"l_knee": CONTRADICTED}, AT)
    assert (proof_of(after), new, gone) == (None, [], ["l_knee"])


def test_an_eye_is_kept_as_such_and_replaces_no_gravity() -> None:
    seen = verdict(SignProofStatus.UNOBSERVABLE, confirmed=True)
    after, _, _ = with_proofs(MADE, {"l_knee": seen}, AT)
    found = proof_of(after)
    assert isinstance(found, dict) and found["sign"] == "operator"
    before, _, _ = with_proofs(MADE, {"l_knee": verdict()}, AT)
    assert with_proofs(before, {"l_knee": seen}, AT)[0] == before
    assert with_proofs(after, {"l_knee": verdict()}, AT)[1] == ["l_knee"]


def test_a_saved_file_keeps_who_may_read_it_and_a_first_one_needs_its_folder(tmp_path: Path) -> None:
    path = tmp_path / "one.yaml"
    save(MADE, path)
    path.chmod(0o604)
    save(with_proofs(MADE, {"l_knee": verdict()}, AT)[0], path)
    assert path.stat().st_mode & 0o777 == 0o604
    assert len(list(tmp_path.glob("one.*.yaml"))) == 1, "the earlier one is kept"
    with pytest.raises(Rejected, match="mkdir -p"):
        save(MADE, tmp_path / "none" / "one.yaml")
    with pytest.raises(Rejected, match=r"does not end in \.yaml"):
        save(MADE, tmp_path / "one.txt")


# ------------------------------------------------------------------------------------- the plan


@pytest.mark.parametrize(
    ("name", "base", "bent"),
    [
        ("l_hip_pitch", "back", None),
        ("r_knee", "back", "r_knee"),  # in the middle of its travel
        ("l_hip_roll", "left", None),
        ("l_hip_yaw", "left", "l_hip_pitch"),
        ("waist_pitch", "upright", "l_hip_pitch"),
    ],
)
def test_the_simplest_way_that_proves_a_joint_is_planned(name: str, base: str, bent: str | None) -> None:
    way = best(PosedModel(H24), H24.names.index(name), radians(15.0), 0.1)
    assert way is not None and way.foreseen.observable
    assert way.base == base
    assert (None if way.bend is None else H24.names[way.bend[0]]) == bent


def test_a_joint_that_no_pose_shows_is_planned_for_the_eye() -> None:
    way = best(PosedModel(H24), H24.names.index("l_ankle_roll"), radians(15.0), 0.1)
    assert way is not None and not way.foreseen.observable
    assert way.foreseen.flip < 0.1


def test_a_plan_needs_no_robot_and_prints_the_commands(tmp_path: Path, capsys: Captured) -> None:
    words = ["--socket", str(tmp_path), "calibrate", "prove", "--plan", "--robot", "h24"]
    assert main([*words, "l_knee", "waist_pitch", "l_ankle_roll"]) == 0
    said = capsys.readouterr().out
    assert f"twindctl --socket {tmp_path} calibrate prove --base back --with l_knee=1.05 l_knee`" in said
    assert (
        "calibrate prove --base upright --with l_hip_pitch=-1 waist_pitch`" in said
    )  # lying it bears too much
    assert "prop it: waist_pitch holds 3.6 of its 4.1 N·m" in said
    assert "by your eye alone:\n    at most (N·m): l_ankle_roll 0.06" in said
    assert main(["--json", *words, "l_kne"]) == 1
    assert "no joint 'l_kne'" in json.loads(capsys.readouterr().out)["parameters"]["message"]


def test_joints_of_a_transmission_are_not_planned(tmp_path: Path, capsys: Captured) -> None:
    robot = linked(tmp_path)
    assert main(["calibrate", "prove", "--plan", "--robot", str(robot.path)]) == 0
    said = capsys.readouterr().out
    *_, last = said.splitlines()
    assert last.startswith("not judged, turned by a transmission or without room: waist_roll, ")
    assert "knee" not in last


# ------------------------------------------------------------------------------------- what makes no sense


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "how is the base held: say --base upright, back"),
        (["--base", "side"], "no base pose 'side': say --base"),
        (["--base", "back", "--degrees", "nan"], "--degrees nan is outside 3 to 45"),
        (["--base", "back", "--friction", "-1"], "--friction -1 is outside"),
    ],
)
def test_an_invalid_option_is_a_usage_error(
    words: list[str], message: str, tmp_path: Path, capsys: Captured
) -> None:
    assert main(["--socket", str(tmp_path), "calibrate", "prove", *words]) == 2
    assert message in capsys.readouterr().err


def test_a_missing_daemon_gives_the_no_daemon_exit_code(tmp_path: Path) -> None:
    assert main(["--socket", str(tmp_path), "calibrate", "prove", "--base", "back", "--yes"]) == 3


def test_a_pose_is_one_of_the_robot_file_with_single_joints_over_it() -> None:
    assert wanted_pose(H24, None, []) == {}
    found = wanted_pose(H24, "stand", ["l_knee=0.9"])
    assert found["l_knee"] == 0.9 and found["r_knee"] == H24.poses["stand"]["r_knee"]
    with pytest.raises(Rejected, match="no pose 'sit'; it has"):
        wanted_pose(H24, "sit", [])
    with pytest.raises(Rejected, match="no joint 'knee'"):
        wanted_pose(H24, None, ["knee=1"])
    for bad in ("l_knee", "l_knee=up", "l_knee=nan"):
        with pytest.raises(UsageError, match="JOINT=RAD"):
            wanted_pose(H24, None, [bad])
    assert np.isfinite(list(found.values())).all()
