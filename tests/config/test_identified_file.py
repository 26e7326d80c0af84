"""An identified model reads back as it was written, and refuses what it cannot mean."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.config.config_files import ConfigSources, describe
from twind.config.identified_file import dump_identified, identified_path, read_identified, save_identified
from twind.config.identified_spec import (
    BOUNDS,
    PARAMETERS,
    GapReference,
    IdentifiedBody,
    IdentifiedJoint,
    IdentifiedModel,
    ParameterEstimate,
    PositionEstimate,
)
from twind.config.robot_file import load_robot
from twind.config.yaml_tree import ConfigError

ROBOT = load_robot("h24")
SIZES = st.integers(0, 10**12).map(lambda count: count / 1e9)
SHARES = st.integers(1, 10**9).map(lambda count: count / 1e9)


def estimates(name: str) -> st.SearchStrategy[ParameterEstimate]:
    """Any estimate of the parameter `name` that a file may hold."""
    least, most = BOUNDS[name]
    values = SHARES.map(lambda share: round(least + share * (most - least), 9))
    measured = st.builds(ParameterEstimate, values, SIZES, SIZES, SIZES)
    assumed = values.flatmap(
        lambda value: st.builds(
            ParameterEstimate, st.just(value), SIZES, st.just(value), SIZES, st.just(False)
        )
    )
    return measured | assumed


JOINTS = st.builds(
    IdentifiedJoint,
    **{name: st.none() | estimates(name) for name in PARAMETERS},
    p_gain=st.none() | st.integers(1, 16383).map(float),
    gap=st.none() | st.builds(GapReference, SIZES, SIZES, st.none() | SIZES, st.none() | SIZES),
)
PLACES = st.tuples(*[st.integers(-(10**9), 10**9).map(lambda count: count / 1e9)] * 3)
SPREADS = st.tuples(SHARES, SHARES, SHARES)
BODIES = st.builds(
    IdentifiedBody,
    st.none() | estimates("mass_kg"),
    st.none() | st.builds(PositionEstimate, PLACES, SPREADS, PLACES),
)
MODELS = st.builds(
    IdentifiedModel,
    st.just("h24"),
    st.just("2026-11-28T10:00:00Z"),
    st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1),
    st.just('two "files"'),
    SIZES,
    st.just(0.25),
    st.dictionaries(st.sampled_from(ROBOT.names), JOINTS, max_size=3),
    st.dictionaries(st.sampled_from(["torso", "l_shin"]), BODIES, max_size=2),
)
ESTIMATE = ParameterEstimate(0.2, 0.01, 0.1, 0.05)
MODEL = IdentifiedModel(
    "h24",
    "2026-11-28T10:00:00Z",
    "twindctl identify",
    "a.mcap",
    60.0,
    0.25,
    {"l_knee": IdentifiedJoint(friction_nm=ESTIMATE)},
)


@given(MODELS)
def test_an_identified_model_reads_back_as_written(model: IdentifiedModel) -> None:
    assert read_identified(dump_identified(model), "file", ROBOT) == model


@pytest.mark.parametrize(
    ("old", "new", "path"),
    [
        ('robot: "h24"', 'robot: "other"', "robot"),
        ("l_knee", "no_knee", "joints.no_knee"),
        ('value": 0.2', 'value": -0.2', "joints.l_knee.friction_nm.value"),
        ('value": 0.200000000', 'value": .nan', ""),  # no number of YAML that we take
        ('value": 0.200000000', 'value": .inf', ""),
        ('value": 0.200000000', 'value": "much"', "joints.l_knee.friction_nm.value"),
        ("friction_nm", "frictoin_nm", "joints.l_knee.frictoin_nm"),
        ("friction_nm", "stiffness_nm_per_deg", "joints.l_knee.stiffness_nm_per_deg"),
        ("    friction_nm", "    p_gain: 0.0\n    friction_nm", "joints.l_knee.p_gain"),
        ("held_out: 0.25", "held_out: 1.0", "held_out"),
        ("twind-identified/1", "twind-identified/2", "format"),
    ],
)
def test_a_wrong_identified_model_is_refused_at_its_place(old: str, new: str, path: str) -> None:
    text = dump_identified(MODEL)
    assert old in text
    with pytest.raises(ConfigError) as refused:
        read_identified(text.replace(old, new), "file", ROBOT)
    assert refused.value.path == path
    assert refused.value.line > 0 or path == "format"


@pytest.mark.parametrize(
    ("estimate", "reason"),
    [
        ("{value: %s, sd: 0.1, prior: 1.0, prior_sd: 0.1}", "is outside"),
        ("{value: 0.2, sd: 0.1, prior: 0.3, prior_sd: 0.1, determined: false}", "is not the prior, 0.3"),
    ],
)
@pytest.mark.parametrize("name", BOUNDS)
def test_a_value_that_its_parameter_cannot_have_is_refused_at_its_key(
    name: str, estimate: str, reason: str
) -> None:
    least, most = BOUNDS[name]
    place = "bodies.torso" if name == "mass_kg" else "joints.l_knee"
    section, owner = place.split(".")
    for value in {1.01 * most, 0.0} - {least}:
        text = dump_identified(replace(MODEL, joints={})).replace(
            f"{section}: {{}}", f"{section}:\n  {owner}:\n    {name}: {estimate.replace('%s', str(value))}"
        )
        with pytest.raises(ConfigError, match=reason) as refused:
            read_identified(text, "file", ROBOT)
        assert refused.value.path == f"{place}.{name}.value"


def test_the_daemon_reads_the_identified_model_beside_the_calibration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    sources = ConfigSources(mode="sim", robot="h24")
    assert describe(sources).robot.identified is None
    folder = tmp_path / "calibration"
    folder.mkdir()
    path = save_identified(MODEL, folder / "h24.yaml")
    assert path == identified_path(folder / "h24.yaml")
    found = describe(sources)
    assert found.robot.identified == MODEL
    assert str(path) in found.files
    named = tmp_path / "other.yaml"
    named.write_text(dump_identified(replace(MODEL, source="named")))
    identified = describe(replace(sources, identified=str(named))).robot.identified
    assert identified is not None
    assert identified.source == "named"


def _larger(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(100 << 20)


def _loop(path: Path) -> None:
    path.symlink_to(path.name)


def _dangling(path: Path) -> None:
    path.symlink_to("absent.yaml")


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (_larger, "larger than 256 KiB"),
        (_loop, "cannot be read: Too many levels of symbolic links"),
        (_dangling, "cannot be read: No such file"),
        (Path.mkdir, "is a folder, not a file"),
        (os.mkfifo, "is a pipe, not a file"),
    ],
)
@pytest.mark.parametrize("named", [False, True])
def test_a_daemon_does_not_start_beside_something_else_than_an_identified_model(
    make: Any, reason: str, named: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    path = identified_path(tmp_path / "calibration" / "h24.yaml")
    path.parent.mkdir()
    make(path)
    sources = ConfigSources(mode="sim", robot="h24", identified=str(path) if named else None)
    with pytest.raises(ConfigError, match=reason) as refused:
        describe(sources)
    assert refused.value.file == str(path)


def test_clients_get_date_and_source_of_the_identified_model_with_the_robot(tmp_path: Path) -> None:
    path = save_identified(MODEL, tmp_path / "h24.yaml")
    robot = describe(ConfigSources(mode="sim", robot="h24", identified=str(path))).robot
    told = msgspec.to_builtins(robot, enc_hook=str)["identified"]
    assert (told["created"], told["source"]) == (MODEL.created, MODEL.source)
    assert msgspec.convert(told, IdentifiedModel) == MODEL
