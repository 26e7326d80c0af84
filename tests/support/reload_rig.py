"""Configuration files of a simulated robot, and what a reload makes of their changes."""

from collections.abc import Mapping
from pathlib import Path

import msgspec

from tests.support.doc_pages_text import ROOT
from twind.briefing import Briefing
from twind.config import hot_changes, reload_plan
from twind.config.config_files import ConfigSources, LoadedConfig, describe, pack
from twind.loop.tick import assembly
from twind.loop.tick.bound_robot import BoundRobot
from twind.sealed_memfd import unseal
from twind.twin.binding import bind


def files(folder: Path, settings: str = "", robot: Mapping[str, str] | None = None) -> ConfigSources:
    """A sim of a copy of h24 in `folder`; `robot`: what stands in its file -> what shall."""
    source = ROOT / "twind" / "robots"
    text = (source / "h24.yaml").read_text().replace("mjcf: h24.xml", f"mjcf: {source}/h24.xml")
    for old, new in (robot or {}).items():
        assert old in text
        text = text.replace(old, new)
    (folder / "body.yaml").write_text(text)
    (folder / "twind.yaml").write_text(f"mode: sim\nrobot: body.yaml\n{settings}")
    return ConfigSources(config=str(folder / "twind.yaml"))


def reread_of(old: LoadedConfig, sources: ConfigSources) -> tuple[hot_changes.ConfigDifference, LoadedConfig]:
    new = describe(sources)
    found = reload_plan.difference(old, new)
    return found, reload_plan.in_force(old, new, found)


def briefed(sources: ConfigSources) -> Briefing:
    """As the daemon's start does it."""
    told = describe(sources)
    one = BoundRobot(told.robot, told.calibration, bind(told.robot, told.calibration))
    settings = told.settings
    fd = assembly.make_briefing(
        one, told.rate_hz, settings.parameters(), settings.log_level, told.files, pack(sources, told)
    )
    return msgspec.msgpack.decode(unseal(fd), type=Briefing)
