"""Files read again beside the configuration in force: changes that may be applied now, and their result."""

from dataclasses import replace

from twind.config import hot_changes
from twind.config.calibration_file import Calibration
from twind.config.config_files import LoadedConfig
from twind.config.config_reader import Plain
from twind.config.hot_changes import Changes, ConfigDifference, same
from twind.config.hot_keys import PROOF


def difference(old: LoadedConfig, new: LoadedConfig) -> ConfigDifference:
    """Hot changes, and the keys that wait for a restart. Of another robot only its name is told apart."""
    settings = hot_changes.settings_difference(old.settings, new.settings)
    restart = set(settings.restart)
    changes = dict(settings.changes)
    proofs = proven(old.calibration, new.calibration)
    if proofs is not None:
        changes[PROOF] = proofs
    elif not same(old.calibration, new.calibration):
        restart.add("calibration")
    if old.robot.path != new.robot.path:
        restart.add("robot")
    else:
        robot = hot_changes.robot_difference(old.robot, new.robot)
        changes |= robot.changes
        restart |= set(robot.restart)
    return ConfigDifference(dict(sorted(changes.items())), tuple(sorted(restart)))


def proven(old: Calibration | None, new: Calibration | None) -> dict[str, Plain] | None:
    """Actuator -> its proof, of those whose proof differs; None: something else differs too, or nothing does.

    When the file was written, and by what, is no difference of its own.
    """
    if old is None or new is None or same(old, new):
        return None
    if not same(_measured(old), _measured(new)):
        return None
    pairs = zip(old.joints, new.joints, strict=True)
    return {now.name: now.proof for was, now in pairs if not same(was.proof, now.proof)}


def _measured(calibration: Calibration) -> Calibration:
    joints = tuple(replace(joint, proof=None) for joint in calibration.joints)
    return replace(calibration, joints=joints, created="", tool="", sha256="")


def in_force(old: LoadedConfig, new: LoadedConfig, found: ConfigDifference) -> LoadedConfig:
    """Return the configuration in force once `found` is applied. Raises InvalidInput.

    Files whose contents are in force whole count as read now; the others as read before. So arming never
    relies on contents that are not in force.
    """
    made = with_changes(old, found.changes)
    settings = made.settings
    files = dict(old.files)
    robot = made.robot
    if same(new.settings, replace(settings, source=new.settings.source, origins=new.settings.origins)):
        settings = new.settings
    if PROOF in found.changes:
        made = replace(made, calibration=new.calibration)
    if same(made.calibration, new.calibration) and set(old.files) == set(new.files):
        files = dict(new.files)
    path = str(old.robot.path)
    if same(new.robot, replace(robot, text_sha256=new.robot.text_sha256)):
        robot = new.robot
    elif path in files:
        files[path] = old.files[path]
    model = str(old.robot.mjcf_path)
    if model in files and new.robot.mjcf != robot.mjcf:
        files[model] = old.files[model]
    if not same(new.robot.transmissions, robot.transmissions):
        tables = (each.table for each in robot.transmissions if each.table)
        files |= {path: old.files[path] for path in map(str, (table.absolute() for table in tables))}
    return replace(made, settings=settings, robot=robot, files=files)


def with_changes(old: LoadedConfig, changes: Changes) -> LoadedConfig:
    """The same with these changes. Raises InvalidInput."""
    settings = hot_changes.settled(old.settings, changes)
    robot = hot_changes.applied(old.robot, changes)
    return replace(old, settings=settings, robot=robot)
