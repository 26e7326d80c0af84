"""Modes, units and firmware of each model, against the vendor's own files."""

from math import pi
from pathlib import Path

import pytest

from twind_drivers.dynamixel import control_tables
from twind_drivers.dynamixel.control_tables import models, number_of, table
from twind_drivers.dynamixel.dynamixel_models import FACTS, facts, page

README = Path(__file__).parents[2] / "drivers" / "README.md"
EVERY = [table(number) for number in models().values()]
# Where the manual and the vendor's file disagree, hence None in ours; the XL320's file has 4096.
DISPUTED = {"rh_p12_rn", "xl320"}


def test_every_model_of_the_index_has_facts_and_a_page_they_come_from() -> None:
    for each in EVERY:
        assert each.facts.effort in each, each.stem
        assert each.facts.modes or each.facts.undriven, each.stem
        assert page(each.stem).startswith(("dxl/", "platform/")), each.stem


def test_no_facts_stand_there_for_a_model_that_the_index_lacks() -> None:
    assert set(FACTS) == {each.stem for each in EVERY}
    with pytest.raises(KeyError, match="xm999"):
        facts("xm999_w1")


def test_a_model_has_the_modes_that_its_registers_allow() -> None:
    for each in EVERY:
        if "operating_mode" in each:
            assert ({0, 5} & each.facts.modes != set()) == ("goal_current" in each), each.stem
        assert (each.facts.ampere_per_count is not None) == ("present_current" in each), each.stem


def test_counts_and_velocities_agree_with_the_vendors_file() -> None:
    """`[type info]` and `[unit info]` of the .model files; they round, and count 4095 of 4096: 0.1 %."""
    for each in EVERY:
        if each.stem in DISPUTED:
            assert each.facts.counts_per_turn is None, each.stem
            continue
        turn, velocity, centre = _file(each.stem)
        assert each.facts.centre == centre, each.stem
        assert each.facts.counts_per_turn == pytest.approx(turn, rel=1e-3), each.stem
        assert each.facts.radians_per_velocity_count == pytest.approx(velocity, rel=1e-3), each.stem


def _file(stem: str) -> tuple[float, float, int]:
    """Counts a turn, rad/s of a count, and the count of 0 rad."""
    text = (
        (control_tables.model_folder() / f"{stem}.model").read_text("utf-8").partition("[control table]")[0]
    )
    rows = {row[0]: row[1] for line in text.splitlines() if len(row := line.split("\t")) > 1}
    span = [float(rows[f"value_of_{end}_radian_position"]) for end in ("min", "max")]
    angles = [float(rows[f"{end}_radian"]) for end in ("min", "max")]
    turn = (span[1] - span[0]) * 2.0 * pi / (angles[1] - angles[0])
    return turn, float(rows["Present Velocity"]), int(rows["value_of_zero_radian_position"])


def test_every_register_required_by_firmware_facts_exists() -> None:
    for each in EVERY:
        register = {
            "bus_watchdog": each.facts.watchdog_from,
            "startup_configuration": each.facts.startup_from,
            "backup_ready": each.facts.backup_from,
            "drive_mode": each.facts.torque_on_by_goal_from,
        }
        assert [key for key, least in register.items() if least is not None and key not in each] == [], (
            each.stem
        )


@pytest.mark.parametrize(
    ("name", "turn", "milliampere", "fast"),
    [
        ("XM430-W350", 4096, 2.69, 45),  # dxl/x/xm430-w350; protocol2, "Fast Sync Read"
        ("XH430-V350", 4096, 1.34, 45),  # dxl/x/xh430-v350, "Current Limit(38)"
        ("XL430-W250", 4096, None, 45),  # dxl/x/xl430-w250: "Present Load(126)"
        ("2XL430-W250", 4096, None, None),  # protocol2 names no firmware of it
        ("XC330-T288", 4096, 1.0, 46),  # dxl/x/xc330-t288
        ("MX-106", 4096, 3.36, None),  # dxl/mx/mx-106-2, "Current Limit(38)"
        ("PH42-020-S300", 607_500, 1.0, 12),  # dxl/p/ph42-020-s300-r: limits +-303,750
        ("PM54-060-S250", 502_834, 1.0, 12),  # dxl/pro/m54-60-s250-ra: "Resolution"
        ("H54-200-S500-RA", 1_003_846, 1.0, None),
    ],
)
def test_some_models_against_their_pages(
    name: str, turn: int, milliampere: float | None, fast: int | None
) -> None:
    found = table(number_of(name)).facts
    assert (found.counts_per_turn, found.fast_from) == (turn, fast)
    assert found.ampere_per_count == (None if milliampere is None else pytest.approx(milliampere / 1e3))


def test_the_page_on_drivers_lists_every_model_that_we_drive_with_its_modes() -> None:
    rows = [line.split("|") for line in README.read_text("utf-8").splitlines() if line.startswith("| ")]
    told = {name.strip(): row[2].split() for row in rows if len(row) == 8 for name in row[1].split(",")}
    for each in EVERY:
        if not each.facts.undriven:
            assert told[each.model] == [str(mode) for mode in sorted(each.facts.modes)], each.model


def test_the_model_of_another_family_is_marked_as_undriven() -> None:
    """XL320: its control table has another layout (dxl/x/xl320)."""
    undriven = {each.stem for each in EVERY if each.facts.undriven}
    assert undriven == {each.stem for each in EVERY if each.stem == "xl320"}
