"""The motions of a robot file as paths in joint order, for checks without a daemon."""

from twind.command_line.trajectory_files import load_motion, motion_names
from twind.command_line.verb import Rejected
from twind.config.robot_file import RobotFile
from twind.exceptions import InvalidInput
from twind.front import trajectory_submission
from twind.front.joint_naming import JointNames
from twind.robot.trajectory import Trajectory


def motions_of(robot: RobotFile) -> tuple[dict[str, Trajectory], list[str]]:
    """Paths by name, and what is wrong with the files that are none for this robot."""
    names = JointNames(robot.names)
    paths = {}
    wrong = []
    for name in motion_names(robot.motions) if robot.motions.is_dir() else ():
        try:
            message = trajectory_submission.message_of(load_motion(name, robot.motions))
        except (Rejected, InvalidInput) as error:
            wrong.append(f"motion {name}: {error}")
            continue
        path, findings = trajectory_submission.judge(message, names)
        if path is None:
            wrong.append(f"motion {name}: {names.findings(findings)[0]['message']}")
        else:
            paths[name] = path
    return paths, wrong
