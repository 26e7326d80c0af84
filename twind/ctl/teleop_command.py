"""Move a robot by a keyboard or a gamepad.

Without --mapping, arrows select a joint and move it, digits are poses, letters motions, space stops. Nothing
is faster than jog: 0.2 rad/s, and less for slow joints. Where the terminal reports no releases, a short press
is a step of at most 0.03 rad, and a held key moves on from its first repeat. Ctrl-C ends it; the robot holds.
"""

import argparse
import sys
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from twind.command_line.extras import how_to_add
from twind.command_line.progress import ProgressLine
from twind.command_line.stop_signals import catch_stop_signals
from twind.command_line.trajectory_files import motion_names
from twind.command_line.verb import DONE, REFUSED, Rejected, UsageError, harmless_lines, observer
from twind.exceptions import InvalidInput

group = "drive"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments: the device and its mapping."""
    parser.add_argument(
        "--mapping", type=Path, metavar="FILE", help="what each key, axis or button does (YAML)"
    )
    parser.add_argument(
        "--write-mapping", type=Path, metavar="FILE", help="write the default mapping and end"
    )
    parser.add_argument(
        "--gamepad",
        nargs="?",
        const="",
        metavar="DEVICE",
        help="use a gamepad, instead of the keyboard (default: the first); its dead-man button must be held",
    )
    parser.add_argument("--take", action="store_true", help="take the lease from its present holder")


def run(options: argparse.Namespace) -> int:
    """0 when it was ended by Ctrl-C; 1 when its device is gone."""
    from twind.ctl.teleoperating.default_mapping import mapping_text
    from twind.robot_client.require_armed import require_armed

    with observer(options) as client:
        robot = client.call("GetRobot")["robot"]
        status = client.call("GetStatus")["status"]
    folder = robot.get("motions")
    motions = motion_names(Path(folder)) if isinstance(folder, str) else ()
    if options.write_mapping is None:
        try:
            require_armed(status)  # later this command would hold the lease
        except InvalidInput as error:
            raise Rejected(str(error)) from None
        return _teleoperate(options, robot, motions)
    try:
        with options.write_mapping.open("x") as file:
            file.write(mapping_text(robot, motions))
    except OSError as error:
        raise UsageError(f"{options.write_mapping}: not written: {error.strerror}") from None
    return DONE


def _teleoperate(
    options: argparse.Namespace, description: Mapping[str, Any], motions: tuple[str, ...]
) -> int:
    from twind.ctl.teleoperating.default_mapping import help_lines
    from twind.ctl.teleoperating.teleop_session import TeleopSession
    from twind.robot_client.robot import Robot

    with (
        catch_stop_signals() as ended,
        Robot(options.socket, take=options.take) as robot,
        _opened(options, description, motions) as (mapping, controls, words),
        ProgressLine(options, options.verb) as progress,
    ):

        def tell(text: str) -> None:
            progress.clear()
            print(harmless_lines(text), file=sys.stderr, flush=True)

        tell("\n".join([*help_lines(mapping), words]))
        session = TeleopSession(robot, description, mapping, controls, show=progress.update, tell=tell)
        try:
            session.run(ended)
        except KeyboardInterrupt:
            pass
        except EOFError as error:
            tell(f"{error}; the robot holds")
            return REFUSED
    return DONE


@contextmanager
def _opened(
    options: argparse.Namespace, robot: Mapping[str, Any], motions: tuple[str, ...]
) -> Iterator[tuple[Any, Any, str]]:
    """Open the device; yield the mapping, the device, and a line on it. Raises UsageError, Rejected."""
    from twind.ctl.teleoperating.default_mapping import default_gamepad, default_keys
    from twind.ctl.teleoperating.key_terminal import KeyTerminal

    if options.gamepad is None:
        mapping = _loaded(options.mapping, robot, motions, None) or default_keys(robot, motions)
        with closing(KeyTerminal()) as keys:
            releases = (
                "" if keys.has_releases else "; this terminal reports no releases: a short press is a step"
            )
            yield mapping, keys, f"hold a key to move, Ctrl-C ends{releases}"
        return
    with closing(_gamepad(options.gamepad)) as pad:
        names = pad.controls
        mapping = _loaded(options.mapping, robot, motions, names) or default_gamepad(robot, names)
        if not mapping.dead_man:
            raise UsageError(
                f"{pad.name} has no usual dead-man button: give --mapping; it has {', '.join(names)}"
            )
        pad.dead_man = mapping.dead_man
        yield mapping, pad, f"{pad.name}: hold {mapping.dead_man} to move, Ctrl-C ends"


def _loaded(path: Path | None, robot: Mapping[str, Any], motions: tuple[str, ...], names: Any) -> Any:
    from twind.config.yaml_tree import ConfigError
    from twind.ctl.teleoperating.teleop_mapping import load_mapping

    try:
        return None if path is None else load_mapping(path, robot, motions, names)
    except ConfigError as error:
        raise UsageError(str(error)) from None


def _gamepad(path: str) -> Any:
    try:
        from twind.ctl.teleoperating.gamepad_input import open_gamepad
    except ImportError:
        raise UsageError(f"--gamepad needs evdev: {how_to_add('gamepad')}") from None
    return open_gamepad(path)
