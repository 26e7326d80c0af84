"""Cards to fill in, one per framework: terms, order, scales and names of its example for legged robots.

The facts were read in the public sources that each file of `templates/` names, as stored in November 2026;
what could not be read is marked `unverified` there. Robots, tasks and forks differ.
"""

from pathlib import Path

from twind.config.robot_file import RobotFile
from twind.learn.cards.interface_card import FORMAT
from twind.twin.binding import bind

FOLDER = Path(__file__).with_name("templates")


def template_text(name: str, robot: RobotFile) -> str:
    """Return the card of a framework, the name of a file in `FOLDER`, for a robot. Raises InvalidInput."""
    text = (FOLDER / f"{name}.yaml").read_text(encoding="utf-8")
    joints = breadth_first(robot) if name == "isaaclab" else model_order(robot)
    legs = [each for each in joints if each in robot.legs] if name == "toddlerbot" else joints
    pose = robot.poses.get("stand", robot.poses["rest"])
    head = [
        f"format: {FORMAT}",
        f"robot: {robot.name}",
        "rate_hz: 50.0",
        f"decimation: {10 if name in ('playground', 'open-duck') else 4}",
        *_wrapped("joints: [", ", ".join(legs), "]"),
        "signs: {}                 # joint: -1 where the training's axis points the other way",
        *_wrapped("default_rad: {", ", ".join(f"{each}: {float(pose[each])}" for each in joints), "}"),
        "# test: {file: NAME.npz}  # arrays obs (k, ...) and the action (k, n): the check replays them",
    ]
    return text.replace("@HEAD@", "\n".join(head)).replace("@JOINTS@", ", ".join(joints))


def model_order(robot: RobotFile) -> list[str]:
    """Return the joints in the order of the model."""
    return [name for _, _, name in sorted(_tree(robot), key=lambda each: each[1])]


def breadth_first(robot: RobotFile) -> list[str]:
    """Return the joints by their depth in the tree, else in the order of the model."""
    return [name for _, _, name in sorted(_tree(robot))]


def _tree(robot: RobotFile) -> list[tuple[int, int, str]]:
    """Depth, place in the model and name of each joint."""
    model = bind(robot, None).model
    found = []
    for joint in robot.joints:
        number = int(model.joint(joint.model_joint).id)
        body = int(model.jnt_bodyid[number])
        depth = 0
        while body:
            body = int(model.body_parentid[body])
            depth += 1
        found.append((depth, number, joint.name))
    return found


def _wrapped(begin: str, text: str, end: str) -> list[str]:
    """Lines of at most 100 characters that hold a list."""
    lines = [begin]
    for part in text.split(", "):
        if len(lines[-1]) + len(part) > 98:
            lines[-1] = lines[-1].rstrip()
            lines.append("  ")
        lines[-1] += f"{part}, "
    lines[-1] = lines[-1].removesuffix(", ") + end
    return lines
