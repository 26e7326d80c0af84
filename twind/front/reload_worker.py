"""Reload worker: reads the files again in a separate process, with a briefing on standard input.

Started by the front as `python -m twind.front.reload_worker`; the front goes on serving. Reading YAML and
compiling a model takes long, and a failure of the compiler ends only this process. It checks everything as a
start does, and changes nothing.
"""

import sys

import msgspec

from twind.briefing import Briefing, ReloadResult
from twind.config import config_files, reload_plan
from twind.config.config_files import describe
from twind.config.hot_keys import of_robot
from twind.config.yaml_tree import ConfigError
from twind.front.next_briefing import with_files
from twind.twin import binding_transfer
from twind.twin.binding import Binding, bind, rebound
from twind.twin.simulation import hush


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


if __name__ == "__main__":
    sys.exit(main())
