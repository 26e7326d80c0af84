"""The real rclpy for tests: an environment of its own (`make ros`), alone on 127.0.0.1, and its programs.

`python()` skips where it is missing. What a program needs of its graph is in its environment (`environment`):
Fast DDS by UDP on 127.0.0.1 alone, unicast, no shared memory; a domain that the caller asks for.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

# What a ROS that is sourced puts into an environment.
SOURCED = ("ROS_", "RMW_", "FAST", "AMENT_", "COLCON_", "CYCLONEDDS_", "PYTHONPATH", "LD_LIBRARY_PATH")
PREFIX = Path(sys.prefix) / "ros"  # what `make ros` makes
PROFILE = """<?xml version="1.0" encoding="UTF-8" ?>
<dds xmlns="http://www.eprosima.com"><profiles>
  <transport_descriptors><transport_descriptor>
    <transport_id>here</transport_id><type>UDPv4</type>
    <interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>
  </transport_descriptor></transport_descriptors>
  <participant profile_name="here" is_default_profile="true"><rtps>
    <userTransports><transport_id>here</transport_id></userTransports>
    <useBuiltinTransports>false</useBuiltinTransports>
    <builtin>
      <metatrafficUnicastLocatorList><locator/></metatrafficUnicastLocatorList>
      <initialPeersList><locator><udpv4><address>127.0.0.1</address></udpv4></locator></initialPeersList>
    </builtin>
  </rtps></participant>
</profiles></dds>
"""


def python() -> str:
    """The interpreter whose rclpy is the real one. Skips the test where there is none."""
    found = PREFIX / "bin" / "python"
    if not (PREFIX / ".ready").exists():
        pytest.skip("no real rclpy here: `make ros` (needs Python 3.12)")
    return str(found)


def environment(folder: Path, domain: int) -> dict[str, str]:
    """Environment of a process in that domain; `folder` keeps its profile and logs."""
    profile = folder / "fastdds.xml"
    profile.write_text(PROFILE)
    ours = {key: value for key, value in os.environ.items() if not key.startswith(SOURCED)}
    return ours | {
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",  # the profile's word counts, all of it
        "ROS_LOG_DIR": str(folder),
        "FASTDDS_DEFAULT_PROFILES_FILE": str(profile),
        "PYTHONUNBUFFERED": "1",
    }


def begin(program: str, *words: str, folder: Path, domain: int) -> "subprocess.Popen[str]":
    """A peer that runs `program`, the text of a script; its standard streams are pipes."""
    return subprocess.Popen(
        [python(), "-c", program, *words],
        env=environment(folder, domain),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
