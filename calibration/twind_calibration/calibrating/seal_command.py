"""`twindctl calibrate seal`: a calibration that was written or edited by hand, completed and hashed."""

import argparse
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from twind.command_line.verb import DONE, Rejected, operator, show
from twind.config.calibrated_device import DeviceRecord, device_entries, require_sweep
from twind.config.calibration_file import (
    FORMAT,
    Calibration,
    dump_calibration,
    read_calibration,
    render,
    seam_margin,
    text_hash,
    turn_band,
)
from twind.config.config_reader import ConfigReader, Plain
from twind.config.counts import turn_start
from twind.config.robot_spec import JointSpec, RobotFile
from twind.config.yaml_tree import ConfigError, parse, read_text
from twind.exceptions import InvalidInput
from twind.twin.binding import bind
from twind_calibration.calibrating import file_ownership
from twind_calibration.calibrating.calibration_actuators import slots
from twind_calibration.calibrating.calibration_context import TOOL, now
from twind_calibration.calibrating.entry_writer import agreed, require_terminal
from twind_calibration.calibrating.recorded_devices import records
from twind_calibration.rejection_hints import with_hints
from twind_calibration.robot_description import read

Devices = Callable[[], Mapping[str, DeviceRecord]]  # by actuator, of those that answer


@with_hints
def seal(options: argparse.Namespace) -> int:
    """Write the file anew with its hashes. Raises Rejected, UsageError, ClientError: nothing is written."""
    require_terminal(options)
    path = Path(options.file).absolute()
    robot = read(options).robot

    def devices() -> Mapping[str, DeviceRecord]:
        with operator(options) as client:
            return records(client, robot, slots(robot))

    try:
        text = read_text(path)
        sealed = sealed_calibration(text, str(path), robot, devices, now())
        bind(robot, sealed)
    except (ConfigError, InvalidInput) as error:
        raise Rejected(str(error)) from None
    missing = [slot.name for slot in slots(robot) if slot.name not in sealed.by_name]
    if not options.json:
        for each in sealed.joints:
            low, high = each.sweep_ticks
            print(f"{each.name}: zero at {each.zero_ticks}, sign {each.sign:+d}, travel {low}..{high}")
        print("a wrong zero or travel moves the robot to wrong places, and no check can find it")
    if not agreed(options, f"seal {path}?"):
        raise Rejected("nothing was written")
    with file_ownership.lock_folder(path) as folder:
        if read_text(path) != text:
            raise Rejected(f"{path} was changed during the question: nothing was written; seal it again")
        file_ownership.save(sealed, path, folder)
    done = f"sealed: {path}, {len(sealed.joints)} joints"
    if missing:
        done += f"\nnot calibrated: {', '.join(missing)}"
    show(options, {"written": str(path), "sha256": sealed.sha256, "left": missing}, done)
    return DONE


def sealed_calibration(text: str, file: str, robot: RobotFile, devices: Devices, created: str) -> Calibration:
    """Return the calibration that `text` states, completed.

    A joint needs `zero_ticks` and `sweep_ticks`; other entries follow from the robot file, and a missing
    `device` from `devices`. An edited file, or one of another description, loses its proofs. Raises
    ConfigError.
    """
    top = ConfigReader(file, parse(text, file))
    if top.has("format"):
        top.require_format(FORMAT)
    if top.has("robot") and top.plain("robot") != robot.name:
        raise top.refuse("robot", f"made for robot {top.plain('robot')!r}, not for {robot.name!r}")
    specs = {joint.actuator: joint for joint in robot.joints}
    given = top.section("joints")
    given.require_known(specs)
    sections = given.sections()
    lacking = [name for name, section in sections.items() if not section.has("device")]
    found = devices() if lacking else {}
    for name in lacking:
        if name not in found:
            raise sections[name].refuse("device", "no device answers there, and the file has no entry")
    known = {name: device_entries(found[name]) for name in lacking}
    joints = {name: _entries(section, specs[name], known.get(name)) for name, section in sections.items()}
    stated = (top.plain("sha256"), top.plain("robot_description_sha256"))
    if stated != (text_hash(text), robot.description_sha256):
        for entries in joints.values():
            entries.pop("proof", None)  # of other numbers, as far as anybody knows
    head: dict[str, Plain] = {
        "format": FORMAT,
        "robot": robot.name,
        "robot_description_sha256": robot.description_sha256,
        "created": created,
        "tool": TOOL,
        "method_default": top.plain("method_default") or "import",
    }
    body = render(head, {"joints": joints})
    read_back = read_calibration(f'{body}sha256: "{text_hash(body)}"\n', file, robot)
    return replace(read_back, sha256=text_hash(dump_calibration(read_back)))


def _entries(section: ConfigReader, joint: JointSpec, device: dict[str, Plain] | None) -> dict[str, Plain]:
    """Return the entries of a joint: as given, the others from the robot file and the travel."""
    sweep: Any = section.value("sweep_ticks", tuple[int, int])
    require_sweep(section, sweep)
    turn = joint.type.ticks_per_turn
    usual: dict[str, Plain] = {
        "bus": joint.bus,
        "id": joint.id,
        "sign": joint.sign,
        "zero_sigma_ticks": 0.0,
        "captures": 1,
    }
    if device is not None:
        usual["device"] = device
    derived: dict[str, Plain] = {
        "seam_margin_ticks": seam_margin(sweep, turn, turn_start(joint.type)),
        "turn_band_ticks": list(turn_band(sweep, turn)),
    }
    return usual | {key: section.plain(key) for key in section} | derived
