"""Reload worker: reads the files again in a separate process, with a briefing on standard input.

Started by the front as `python -m twind.front.reload_worker`; the front goes on serving. Reading YAML and
compiling a model takes long, and a failure of the compiler ends only this process. It checks everything as a
start does, and changes nothing.
"""

import sys
from collections.abc import Mapping
from dataclasses import replace

import msgspec

from twind.briefing import Briefing, ReloadResult
from twind.config import config_files, file_changes, reload_plan
from twind.config.config_files import ConfigSources, LoadedConfig, describe
from twind.config.hot_changes import gains_of
from twind.config.hot_keys import of_robot
from twind.config.yaml_tree import ConfigError
from twind.exceptions import InvalidInput
from twind.twin import binding_transfer
from twind.twin.binding import Binding, bind, rebound
from twind.twin.simulation import hush

BY_CLIENT = "SetParameters"  # where such a value comes from


def read_again(briefing: Briefing) -> ReloadResult:
    """Return the differences of the files from `briefing`, and the next briefing with their hot part."""
    try:
        sources, old = config_files.unpacked(briefing.described)
        new = describe(sources)
        hush()
        bind(new.robot, new.calibration)
        found = reload_plan.difference(old, new)
        then = reload_plan.in_force(old, new, found)
        following = with_files(briefing, sources, then)
        following = msgspec.structs.replace(
            following,
            description=msgspec.to_builtins(then.robot, enc_hook=str),
            replaced_gains={},
            calibration=msgspec.to_builtins(then.calibration, enc_hook=str),
        )
        if of_robot(found.changes):
            binding = rebound(binding_transfer.unpacked(briefing.binding), then.robot, then.calibration)
            following = _with_robot(following, binding)
    except (ConfigError, ValueError, OSError) as error:
        return ReloadResult(error=str(error))
    return ReloadResult(changes=dict(found.changes), needs_restart=found.restart, briefing=following)


def _with_robot(briefing: Briefing, binding: Binding) -> Briefing:
    limits = binding.limits
    joints = [
        msgspec.structs.replace(joint, lower=float(lower), upper=float(upper))
        for joint, lower, upper in zip(briefing.joints, limits.lower, limits.upper, strict=True)
    ]
    return msgspec.structs.replace(
        briefing,
        joints=joints,
        binding=binding_transfer.packed(binding),
    )


def main() -> int:
    """One reading, as msgpack on standard output."""
    briefing = msgspec.msgpack.decode(sys.stdin.buffer.read(), type=Briefing)
    sys.stdout.buffer.write(msgspec.msgpack.encode(read_again(briefing)))
    sys.stdout.buffer.flush()
    return 0


def with_files(briefing: Briefing, sources: ConfigSources, then: LoadedConfig) -> Briefing:
    """Return the next briefing with the present content of the files; limits and gains stay as they are."""
    return msgspec.structs.replace(
        briefing,
        parameters=then.settings.parameters(),
        log_level=then.settings.log_level,
        files=dict(then.files),
        texts=file_changes.texts(then.files, briefing.texts),
        described=config_files.pack(sources, then),
        generation=briefing.generation + 1,
    )


def with_settings(briefing: Briefing, changes: Mapping[str, object]) -> Briefing:
    """Return the next briefing with settings and gains changed by a client. Raises InvalidInput, ValueError.

    The gains of the file stay in `replaced_gains` until they are in force again.
    """
    sources, old = config_files.unpacked(briefing.described)
    then = reload_plan.with_changes(old, changes)
    gains = of_robot(changes)
    before = gains_of(old.robot)
    for key in gains:
        if None in before[key].values():
            raise InvalidInput("the robot file leaves some out, so there are none to go back to", where=key)
    named = dict.fromkeys((key.rpartition(".")[2] for key in changes if key not in gains), BY_CLIENT)
    settings = replace(then.settings, origins={**then.settings.origins, **named})
    following = with_files(briefing, sources, replace(then, settings=settings))
    if not gains:
        return following
    now = gains_of(then.robot)
    files = {key: before[key] for key in gains} | briefing.replaced_gains
    described = msgspec.to_builtins(then.robot, enc_hook=str)
    following = msgspec.structs.replace(
        following,
        description=described,
        replaced_gains={key: value for key, value in files.items() if value != now[key]},
    )
    return _with_robot(
        following, rebound(binding_transfer.unpacked(briefing.binding), then.robot, then.calibration)
    )


if __name__ == "__main__":
    sys.exit(main())
