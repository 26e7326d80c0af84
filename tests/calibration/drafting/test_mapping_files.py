"""Files of other software become facts of joints; what is no such file is refused in one line."""

import json
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.robot_description_files import (
    INTERBOTIX,
    LEROBOT,
    POPPY,
    REACHY,
    ROBOTIS,
    ROBOTIS_INIT,
    TODDLER,
)
from twind.command_line.verb import Rejected
from twind_calibration.drafting.mapping_file import built_in_mappings, fill_from_file, read_mapping
from twind_calibration.drafting.robot_draft import RobotDraft

HEAD = "format: twind-mapping/1\nsoftware: x\nreads: json\nmotors: m\nfacts: "

FILES = {
    "Poppy and pypot": (json.dumps(POPPY), "head_y", {"id": 37, "device": "AX-12", "sign": -1}),
    "LeRobot": (json.dumps(LEROBOT), "pan", {"id": 1, "sign": -1, "lower_count": 800, "upper_count": 3200}),
    "ToddlerBot": (
        json.dumps(TODDLER),
        "neck",
        {"id": 3, "device": "XC330", "lower": -0.5, "mode": "extended_position"},
    ),
    "ROBOTIS framework": (
        ROBOTIS,
        "r_sho",
        {"id": 7, "bus": "ttyUSB0", "device": "MX-28", "protocol": 2.0},
    ),
    "ROBOTIS framework, settings of motors": (
        ROBOTIS_INIT,
        "r_sho",
        {"lower_count": 1024, "upper_count": 3072},
    ),
    "Interbotix": (INTERBOTIX, "waist", {"id": 1, "sign": -1, "lower_count": 0, "upper_count": 4095}),
    "Reachy Mini": (REACHY, "body_rotation", {"id": 10, "lower_count": 100, "upper_count": 4000}),
}


def written(folder: Path, text: str) -> Path:
    path = folder / "file"
    path.write_text(text)
    return path


@pytest.mark.parametrize("software", FILES)
def test_each_known_format_is_recognised_and_states_its_facts(software: str, tmp_path: Path) -> None:
    text, joint, facts = FILES[software]
    draft = RobotDraft("r")
    assert fill_from_file(draft, written(tmp_path, text)) == software
    found = draft.joints[joint]
    assert {key: found.get(key) for key in facts} == facts
    assert all(found.source(key) == "file" for key in facts)


def test_every_built_in_mapping_is_tried_above() -> None:
    assert {each.content.software for each in built_in_mappings()} == set(FILES)


def test_degrees_become_rad_and_ports_become_buses(tmp_path: Path) -> None:
    draft = RobotDraft("r")
    fill_from_file(draft, written(tmp_path, json.dumps(POPPY)))
    assert draft.joints["head_y"].get("lower") == pytest.approx(math.radians(-40))
    assert list(draft.buses) == ["main"]
    draft = RobotDraft("r")
    fill_from_file(draft, written(tmp_path, ROBOTIS))
    assert draft.buses["ttyUSB0"].get("baud") == 2_000_000


def test_keys_of_motors_that_are_not_read_are_reported_once(tmp_path: Path) -> None:
    draft = RobotDraft("r")
    fill_from_file(draft, written(tmp_path, json.dumps(TODDLER)))
    told = [each for each in draft.remarks if "not read" in each]
    assert len(told) == 1
    assert "gear_ratio (it links two joints of the model" in told[0] and "kp_real" in told[0]
    assert "id" not in told[0].split(", ") and draft.buses["main"].get("baud") == 2_000_000


def test_motors_of_a_controller_are_found_through_its_groups(tmp_path: Path) -> None:
    motors = dict.fromkeys(("head_y", "abs_z", "l_elbow"), POPPY["motors"]["head_y"])
    groups = {"all": ["head", "spine"], "head": ["head_y"], "spine": ["abs_z", "all"]}
    controllers = {"a": {"port": "x", "attached_motors": ["all"]}, "b": {"attached_motors": ["l_elbow"]}}
    draft = RobotDraft("r")
    text = json.dumps({"controllers": controllers, "motorgroups": groups, "motors": motors})
    fill_from_file(draft, written(tmp_path, text))
    assert {each.name: each.get("bus") for each in draft.joints.values()} == {
        "head_y": "a",
        "abs_z": "a",
        "l_elbow": "b",
    }
    assert draft.buses["a"].get("protocol") == 1.0


def test_an_owners_mapping_reads_an_unknown_format(tmp_path: Path) -> None:
    mapping = tmp_path / "mine.yaml"
    mapping.write_text(
        "format: twind-mapping/1\nsoftware: mine\nreads: json\nmotors: axes.*\nname: label\n"
        "facts:\n  id: {path: bus.node}\n  lower: {path: range.0, scale: 0.5}\n"
        "  sign: {path: flipped, values: {'True': -1, 'False': 1}}\n"
    )
    axes = {"axes": [{"label": "hip", "bus": {"node": 4}, "range": [-2.0, 1.0], "flipped": True}]}
    draft = RobotDraft("r")
    assert fill_from_file(draft, written(tmp_path, json.dumps(axes)), read_mapping(mapping)) == "mine"
    hip = draft.joints["hip"]
    assert (hip.get("id"), hip.get("lower"), hip.get("sign")) == (4, -1.0, -1)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{}", "no known format"),
        ("no file of anything", "no known format"),
        (json.dumps({"pan": {**LEROBOT["pan"], "id": "seven"}}), "pan: id"),
        (json.dumps({"pan": {**LEROBOT["pan"], "id": 1.5}}), "no whole number"),
        (json.dumps({"pan": {**LEROBOT["pan"], "drive_mode": 7}}), "7 is none of 0, 1"),
        ("a: &a [1]\nb: *a\n", "alias"),
    ],
)
def test_what_cannot_be_read_is_refused_in_words(text: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(Rejected, match="file") as refused:
        fill_from_file(RobotDraft("r"), written(tmp_path, text))
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("format: twind-mapping/2\nsoftware: x\nreads: json\nmotors: m\nfacts: {}\n", "twind-mapping/2"),
        ("format: twind-mapping/1\nsoftware: x\nreads: xml\nmotors: m\nfacts: {}\n", "reads"),
        (HEAD + "{colour: {path: c}}\n", "colour"),
        (HEAD + "{id: {path: c, unit: turn}}\n", "turn"),
        ("- 1\n", "object"),
    ],
)
def test_a_mapping_with_a_mistake_is_refused_by_key(text: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(Rejected, match=words):
        read_mapping(written(tmp_path, text))


@given(st.binary(max_size=400))
def test_any_bytes_end_in_facts_or_a_refusal(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.mktemp("any") / "file"
    path.write_bytes(data)
    with pytest.raises(Rejected):
        fill_from_file(RobotDraft("r"), path)


def test_the_first_source_stays_and_a_contradiction_is_reported() -> None:
    draft = RobotDraft("r")
    draft.joint("a").state("id", 1, "scan")
    draft.joint("a").state("id", 1, "file")
    assert list(draft.conflicts()) == []
    draft.joint("a").state("id", 2, "file")
    (told,) = draft.conflicts()
    assert told == "a: id is 1 by scan, 2 by file: correct one, or leave one out"
