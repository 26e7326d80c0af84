"""Files of 0.1.0 serve as they are: settings, robot and model, calibration, recording and flight file.

Their origin is named in tests/data/README.md.
"""

from pathlib import Path

import numpy as np
import pytest

from tests.support.doc_pages_text import ROOT
from twind.config.calibration_file import load_calibration
from twind.config.daemon_settings import load_settings
from twind.config.robot_file import load_robot
from twind.observe.recording import open_recording
from twind.twin.binding import bind

OLD = ROOT / "tests/data/version_0_1_0"
HEAD = 0.2  # rad, the head's way in the two recordings


def test_settings_of_0_1_0_mean_what_they_meant() -> None:
    settings = load_settings(OLD / "twind.yaml", {}, uid=0)
    assert (settings.mode, settings.robot, settings.individual) == ("live", "mine", "mine-0001")
    assert dict(settings.ports) == {"main": "/dev/twind/FT0000"}
    assert (settings.rate_hz, settings.cpu, settings.log_level) == (100.0, 0, "info")
    assert (settings.latency_warn_ms, settings.latency_block_ms) == (50.0, 100.0)
    assert (settings.socket_dir, settings.state_dir) == (Path("/run/twind"), Path("/var/lib/twind"))


def test_a_calibration_of_0_1_0_fits_its_robot_file_and_model() -> None:
    """The digest of the description too: else arming is refused after an upgrade."""
    robot = load_robot("mine", [OLD])
    calibration = load_calibration(OLD / "calibration.yaml", robot)
    assert calibration.robot_description_sha256 == robot.description_sha256
    assert [joint.zero_ticks for joint in calibration.joints][:3] == [2377, 2097, 2006]
    bind(robot, calibration)


@pytest.mark.parametrize("file", ["armed.mcap", "armed.flight"])
def test_a_recording_of_0_1_0_is_read_to_its_end(file: str) -> None:
    found = open_recording(OLD / file)
    assert found.damage == "" and found.robot["name"] == "mine"
    assert found.joints == tuple(joint.name for joint in load_robot("mine", [OLD]).joints)
    np.testing.assert_allclose(found.measured[-1, 0], HEAD, atol=0.001)
    np.testing.assert_allclose(found.goal[-1, 0], HEAD, atol=0.001)
