"""twind.learn.randomise.randomisation_ranges: one file with every range, and what is refused of it."""

from dataclasses import fields
from pathlib import Path

import pytest

from twind.config.yaml_tree import ConfigError
from twind.learn.randomise.randomisation_ranges import (
    FILE,
    NOISE,
    RULES,
    NoiseRanges,
    PushRanges,
    RandomisationRanges,
    load_ranges,
    parse_ranges,
)


def parsed(profile: str) -> RandomisationRanges:
    text = f"format: twind-ranges/1\nprofiles:\n  default: {profile}\n"
    return parse_ranges(text, "mine.yaml", "default")


def test_the_profile_none_touches_nothing() -> None:
    assert load_ranges() == load_ranges("none") == RandomisationRanges()


def test_every_quantity_has_its_rule() -> None:
    assert {*RULES, "pushes", "noise", "measured"} == {each.name for each in fields(RandomisationRanges)}
    assert set(NOISE) == {each.name for each in fields(NoiseRanges)}


def test_the_default_profile_has_every_quantity() -> None:
    ranges = load_ranges("default")
    nothing = RandomisationRanges()
    for name in (*RULES, "pushes", "noise"):
        assert getattr(ranges, name) != getattr(nothing, name), name
    assert all(getattr(ranges.noise, each.name) > 0.0 for each in fields(NoiseRanges))


def test_every_range_of_the_default_profile_stands_beside_its_source() -> None:
    lines = FILE.read_text().splitlines()
    first = lines.index("  default:")
    last = lines.index("  walk:")
    for at, line in enumerate(lines[:last]):
        if at > first and line.startswith("    ") and "[" in line and not line.strip().startswith("#"):
            above = "".join(lines[max(first, at - 8) : at])
            assert any(f"[{source}]" in above for source in "PDTMBO") or "start_" in line, line


def test_a_file_of_ones_own_is_read_by_its_path(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("format: twind-ranges/1\nprofiles: {default: {encoder_zero_deg: [-1.0, 1.0]}}\n")
    assert load_ranges(path).encoder_zero == pytest.approx((-0.0174533, 0.0174533))
    assert load_ranges(str(path)) == load_ranges(path)


def test_pushes_and_noise_are_read() -> None:
    ranges = parsed(
        "{pushes: {every_s: [1.0, 2.0], speed_m_s: [0.1, 0.1], for_s: [0.1, 0.1]}, noise: {gyro_rad_s: 0.2}}"
    )
    assert ranges.pushes == PushRanges((1.0, 2.0), (0.1, 0.1), (0.1, 0.1))
    assert ranges.noise == NoiseRanges(gyro=0.2)


@pytest.mark.parametrize(
    ("profile", "place", "text"),
    [
        ("{mas: [0.9, 1.1]}", "profiles.default.mas", "unknown key; nearest: mass"),
        ("{mass: [1.1, 0.9]}", "profiles.default.mass", "1.1 to 0.9 is empty: the lower end comes first"),
        ("{mass: [0.0, 1.1]}", "profiles.default.mass[0]", "0 is outside >= 0.1 and <= 10"),
        ("{mass: 1.1}", "profiles.default.mass", "a list is expected, found a number (1.1)"),
        ("{mass: [1.0, 1.1, 1.2]}", "profiles.default.mass", "needs 2 values, found 3"),
        (
            "{action_delay_s: [0.0, 0.3]}",
            "profiles.default.action_delay_s[1]",
            "0.3 is outside >= 0 and <= 0.2",
        ),
        ("{imu_delay_s: [-0.1, 0.1]}", "profiles.default.imu_delay_s[0]", "-0.1 is outside >= 0 and <= 0.2"),
        (
            "{noise: {gyro_rad_s: -0.1}}",
            "profiles.default.noise.gyro_rad_s",
            "-0.1 is outside >= 0 and <= 10",
        ),
        ("{noise: {gyro: 0.1}}", "profiles.default.noise.gyro", "unknown key; known: position_rad"),
        ("{pushes: {every_s: [1.0, 2.0]}}", "profiles.default.pushes.speed_m_s", "is required and missing"),
        (
            "{pushes: {every_s: [0.0, 2.0], speed_m_s: [0.1, 0.2], for_s: [0.1, 0.2]}}",
            "profiles.default.pushes.every_s[0]",
            "0 is outside >= 0.02 and <= 3600",
        ),
    ],
)
def test_an_invalid_profile_is_an_error_with_its_line(profile: str, place: str, text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parsed(profile)
    assert (caught.value.line, caught.value.path) == (3, place)
    assert text in caught.value.message


def test_a_profile_that_is_not_there_names_those_that_are() -> None:
    with pytest.raises(ConfigError, match=r"no profile 'defualt': none, default, walk; nearest: default"):
        load_ranges("defualt")


def test_a_file_without_a_profile_is_refused() -> None:
    with pytest.raises(ConfigError, match="no profile 'default': none at all"):
        parse_ranges("format: twind-ranges/1\n", "mine.yaml", "default")


def test_every_profile_is_checked_whichever_is_asked_for() -> None:
    text = "format: twind-ranges/1\nprofiles: {default: {}, hard: {mass: [2.0, 1.0]}}\n"
    with pytest.raises(ConfigError, match=r"profiles\.hard\.mass"):
        parse_ranges(text, "mine.yaml", "default")
