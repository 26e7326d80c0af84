"""A humanoid of 31 PRO servos on four ports, generated from primitives: the size of a THORMANG3."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

KINDS = {  # type: model, continuous torque (N·m) and current (A) of its page, kp of the model's actuator
    "strong": ("H54-200-S500-RA", 44.7, 9.3, 2000),
    "middle": ("H54-100-S500-RA", 25.3, 5.5, 1000),
    "small": ("H42-20-S300-RA", 5.1, 1.5, 200),
}


class Link(NamedTuple):
    """One joint with the capsule behind it. `at`: m from the joint before; `to`: the capsule's end."""

    name: str
    kind: str
    axis: str
    at: str
    to: str
    mass: float
    limits: tuple[float, float]


def chain(side: str, y: float) -> tuple[list[Link], list[Link]]:
    """Return arm and leg of one side."""
    reach = "0 0 -.12"
    arm = [
        Link(f"{side}_shoulder_pitch", "strong", "0 1 0", f"0 {y * 2:g} .3", "0 0 -.05", 1.6, (-1.5, 1.5)),
        Link(f"{side}_shoulder_roll", "strong", "1 0 0", reach, "0 0 -.06", 1.6, (-1.2, 1.2)),
        Link(f"{side}_shoulder_yaw", "middle", "0 0 1", reach, "0 0 -.06", 1.2, (-1.4, 1.4)),
        Link(f"{side}_elbow", "middle", "0 1 0", reach, "0 0 -.06", 1.2, (-2.0, 0.2)),
        Link(f"{side}_wrist_roll", "small", "0 0 1", reach, "0 0 -.04", 0.6, (-1.4, 1.4)),
        Link(f"{side}_wrist_yaw", "small", "1 0 0", reach, "0 0 -.04", 0.6, (-1.0, 1.0)),
        Link(f"{side}_wrist_pitch", "small", "0 1 0", reach, "0 0 -.04", 0.4, (-1.0, 1.0)),
        Link(f"{side}_grip", "small", "1 0 0", reach, "0 0 -.05", 0.3, (-0.1, 1.0)),
    ]
    leg = [
        Link(f"{side}_hip_yaw", "middle", "0 0 1", f"0 {y:g} -.1", "0 0 -.05", 1.6, (-0.8, 0.8)),
        Link(f"{side}_hip_roll", "strong", "1 0 0", "0 0 -.1", "0 0 -.02", 1.6, (-0.5, 0.5)),
        Link(f"{side}_hip_pitch", "strong", "0 1 0", "0 0 -.08", "0 0 -.25", 3.0, (-1.5, 1.0)),
        Link(f"{side}_knee", "strong", "0 1 0", "0 0 -.3", "0 0 -.25", 2.5, (-0.1, 2.2)),
        Link(f"{side}_ankle_pitch", "strong", "0 1 0", "0 0 -.3", "0 0 -.03", 1.0, (-0.9, 0.9)),
        Link(f"{side}_ankle_roll", "middle", "1 0 0", "0 0 -.08", ".1 0 -.02", 0.8, (-0.5, 0.5)),
    ]
    return arm, leg


LEFT = chain("l", 0.1)
RIGHT = chain("r", -0.1)
HEAD = [
    Link("head_yaw", "small", "0 0 1", "0 0 .45", "0 0 .04", 0.6, (-1.4, 1.4)),
    Link("head_pitch", "small", "0 1 0", "0 0 .08", "0 0 .06", 1.0, (-0.6, 0.6)),
]
WAIST = [Link("waist_yaw", "strong", "0 0 1", "0 0 .05", "0 0 .3", 6.0, (-1.2, 1.2))]
# Each port carries one limb; those of the legs also waist and head.
PORTS = {
    "left_arm": LEFT[0],
    "right_arm": RIGHT[0],
    "left_leg": [*LEFT[1], *WAIST],
    "right_leg": [*RIGHT[1], *HEAD],
}


def _tree(links: list[Link], inside: str = "") -> str:
    """Return the bodies of a chain, each within the one before; `inside`: further bodies in the last."""
    for link in reversed(links):
        low, high = link.limits
        inside = (
            f'<body name="{link.name}" pos="{link.at}"><joint name="{link.name}" axis="{link.axis}" '
            f'range="{low - 0.2:g} {high + 0.2:g}" damping="1" armature=".1"/>'
            f'<geom type="capsule" fromto="0 0 0 {link.to}" size=".02" mass="{link.mass}"/>{inside}</body>\n'
        )
    return inside


def _body() -> str:
    upper = "".join(map(_tree, (HEAD, LEFT[0], RIGHT[0])))
    trunk = _tree(WAIST, upper) + _tree(LEFT[1]) + _tree(RIGHT[1])
    motors = "\n".join(
        f'<position joint="{link.name}" kp="{KINDS[link.kind][3]}" kv="{KINDS[link.kind][3] / 50:g}"/>'
        for links in PORTS.values()
        for link in links
    )
    return (
        '<mujoco model="pro31"><compiler angle="radian" autolimits="true"/>\n'
        '<option timestep="0.002" integrator="implicitfast" jacobian="dense">'
        '<flag contact="disable"/></option>\n'
        '<worldbody><body name="pelvis" pos="0 0 1.1"><freejoint/>'
        f'<geom type="box" size=".08 .06 .04" mass="4"/>\n{trunk}</body></worldbody>\n'
        f"<actuator>{motors}</actuator></mujoco>\n"
    )


def _lines(rate_hz: int, baud: int) -> Iterator[str]:
    yield "format: twind-robot/1\nname: pro31\nmodel: {mjcf: pro31.xml, base: pelvis}\nsupport: gantry"
    yield f"loop: {{rate_hz: {rate_hz}}}\nbuses:"
    yield from (f"  {port}: {{kind: dynamixel2, baud: {baud}}}" for port in PORTS)
    yield "types:"
    for kind, (model, torque, current, _) in KINDS.items():
        yield (
            f"  {kind}: {{device: {model}, mode: extended_position, return_delay_us: 10, "
            "gains: {p: 500, i: 0, d: 0}, "
            f"torque_constant_nm_per_a: {torque / current:.2f}, velocity_limit_rad_s: 2.0, "
            "acceleration_limit_rad_s2: 10.0}"
        )
    yield "joints:"
    for port, links in PORTS.items():
        for id, link in enumerate(links, 1):
            low, high = link.limits
            yield f"  {link.name}: {{type: {link.kind}, bus: {port}, id: {id}, limits_rad: [{low}, {high}]}}"
    yield "poses: {rest: {}}"


def pro_humanoid(folder: Path, *, rate_hz: int = 100, baud: int = 1_000_000) -> Path:
    """Write model and robot file to `folder`; return the path of the robot file."""
    (folder / "pro31.xml").write_text(_body())
    path = folder / "pro31.yaml"
    path.write_text("\n".join(_lines(rate_hz, baud)) + "\n")
    return path
