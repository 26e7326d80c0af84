"""The section `sensors` of a robot file: what is described is there, what is wrong is refused at its line."""

from math import radians
from pathlib import Path

import pytest

from twind.config.cycle_budget import budgets
from twind.config.hot_changes import robot_difference
from twind.config.robot_file import load_robot, read_robot
from twind.config.robot_spec import RobotFile
from twind.config.yaml_tree import ConfigError
from twind.exceptions import InvalidInput
from twind.twin.binding import bind

STANDING = load_robot("h24-standing")
TEXT = STANDING.path.read_text()


def read(folder: Path, old: str = "", new: str = "") -> RobotFile:
    assert old in TEXT
    (folder / "h24.xml").write_text(STANDING.mjcf)
    path = folder / "standing.yaml"
    path.write_text(TEXT.replace(old, new) if old else TEXT)
    return read_robot(path)


def test_every_described_value_is_read() -> None:
    imu = STANDING.imu
    assert imu is not None
    assert (imu.bus, imu.id, imu.site, imu.rotation) == ("main", 200, "imu", None)
    assert imu.gyro.lsb == pytest.approx(radians(0.061035))
    assert (imu.gyro.type, imu.gyro.kind, imu.gyro.count, imu.gyro.end) == ("int16", "<i2", 3, 22)
    assert imu.quaternion is not None and imu.quaternion.order == "wxyz"
    assert imu.span == (16, 20)


def test_a_robot_without_sensors_has_none(tmp_path: Path) -> None:
    assert load_robot("h24").imu is None
    assert read(tmp_path, TEXT[TEXT.index("sensors:") :], "sensors: {}\n").imu is None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("bus: main\n    id", "bus: mian\n    id", "sensors.imu.bus: 'mian' is none of main; nearest: main"),
        ("id: 200", "id: 24", "sensors.imu.id: 24 on bus main is that of joint r_ankle_roll"),
        ("id: 200", "id: 253", "sensors.imu.id: 253 is outside >= 0 and <= 252"),
        ("site: imu", "sites: imu", "sensors.imu.sites: unknown key; nearest: site"),
        ("    site: imu\n", "", "sensors.imu.site: is required and missing"),
        ("16, type: int16", "16, type: int12", "sensors.imu.gyro.type: 'int12' is none of int8"),
        ("lsb_m_s2: 0.0047884", "lsb_m_s2: 0", "sensors.imu.acceleration.lsb_m_s2: 0 is outside > 0"),
        (", lsb_m_s2: 0.0047884", "", "sensors.imu.acceleration.lsb_m_s2: is required and missing"),
        ("address: 28", "address: 400", "sensors.imu: registers 16..407 are 392 bytes, at most 128"),
        ("site: imu", "site: imu\n    rotation: [1, 1, 0, 0]", "w x y z has length 1, this one 1.414"),
        ("site: imu", "site: imu\n    rotation: [1, 0, 0]", "needs 4 values, found 3"),
        ("delay_us: 10\n    gyro", "delay_us: 600\n    gyro", "return_delay_us: 600 is outside"),
        ("  imu:\n    bus", "  lidar: {}\n  imu:\n    bus", "sensors.lidar: unknown key; nearest"),
        ("lsb: 0.00006103515625", "lsb: 0.00006, order: zyxw", "'zyxw' is none of wxyz, xyzw"),
    ],
)
def test_an_invalid_value_is_refused_at_its_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read(tmp_path, old, new)
    text = str(caught.value)
    assert message.removesuffix("; nearest") in text
    line = int(text.removeprefix(str(tmp_path / "standing.yaml")).split(":")[1])
    assert line >= TEXT[: TEXT.index("sensors:")].count("\n"), "it names the line"


def test_a_site_that_the_base_lacks_is_refused_by_the_model_at_its_line(tmp_path: Path) -> None:
    robot = read(tmp_path, "site: imu", "site: l_sole")
    line = TEXT[: TEXT.index("site: imu")].count("\n") + 1
    with pytest.raises(InvalidInput, match=rf"standing.yaml:{line}:\d+: .*no site 'l_sole'; it has imu"):
        bind(robot, None)


def test_can_buses_have_no_imu(tmp_path: Path) -> None:
    mixed = load_robot("h24-mixed")
    (tmp_path / "h24.xml").write_text(mixed.mjcf)
    path = tmp_path / "mixed.yaml"
    path.write_text(
        mixed.path.read_text() + TEXT[TEXT.index("sensors:") :].replace("bus: main", "bus: l_leg")
    )
    with pytest.raises(ConfigError, match="l_leg is of kind can: an IMU is read on a dynamixel2 bus"):
        read_robot(path)


def test_the_budget_counts_it_with_its_return_delay(tmp_path: Path) -> None:
    """Both ways: 14 bytes ask for it, 11 and 20 answer."""
    (without,) = budgets(load_robot("h24"), 100.0)
    (one,) = budgets(STANDING, 100.0)
    (slow,) = budgets(read(tmp_path, "delay_us: 10\n    gyro", "delay_us: 500\n    gyro"), 100.0)
    bytes_of = {each: int(each.lines[1].split(": ")[1].split()[0]) for each in (without, one)}
    assert bytes_of[one] - bytes_of[without] == 14 + 11 + 20
    assert any("reading of a sensor, 20 bytes: 45 bytes = 225 us" in line for line in one.lines)
    assert slow.plain.seconds - one.plain.seconds == pytest.approx(490e-6)
    assert one.plain.seconds - without.plain.seconds == pytest.approx(225e-6 + 10e-6 + 1e-3), (
        "and the adapter"
    )


def test_a_change_of_it_waits_for_a_restart(tmp_path: Path) -> None:
    assert "sensors.imu" in robot_difference(STANDING, read(tmp_path, "id: 200", "id: 201")).restart


def test_the_calibration_is_not_bound_to_it(tmp_path: Path) -> None:
    assert read(tmp_path, "id: 200", "id: 201").description_sha256 == STANDING.description_sha256
