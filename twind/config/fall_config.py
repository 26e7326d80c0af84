"""Section `fall` of a robot file: whether a fall is detected, and what the daemon does then.

Knows the file alone: that the model has feet is found out by `twind/twin/support_geometry.py`.
"""

from collections.abc import Collection
from typing import Annotated, Literal

from msgspec import Meta

from twind.config.config_reader import ConfigReader, ConfigStruct, Text
from twind.robot.fall_settings import FallReaction, FallSettings

REMEDY = "or leave `fall` out"


class FallKeys(ConfigStruct):
    """Section `fall`."""

    reaction: Literal["hold", "soft", "fold"]
    """see [falls](safety.md#falls)"""
    pose: Text = "fold"
    """pose | | with `fold`: pose of `poses`"""
    outside_m: Annotated[float, Meta(ge=0.0, le=0.5)] = 0.03
    """distance of the capture point outside the feet that counts as a fall …"""
    after_ms: Annotated[float, Meta(ge=0.0, le=500.0)] = 30.0
    """… for so long"""
    tilt_rad: Annotated[float, Meta(gt=0.0, le=3.14)] = 0.8
    """rad of the base that count as a fall, wherever the feet are"""
    upright_rad: Annotated[float, Meta(gt=0.0, le=1.5)] = 0.3
    """< `tilt_rad` | 0.3 | rad below which it counts as standing; above, arming is refused"""


def fall_of(
    top: ConfigReader, given: FallKeys | None, support: str, *, inertial: bool, poses: Collection[str]
) -> FallSettings | None:
    """The settings of fall detection; None: the file does not ask for it. Raises ConfigError.

    `inertial`: the robot has an IMU.
    """
    if given is None:
        return None
    if support != "free":
        raise top.refuse("fall", f"support is {support}, which carries the robot: `support: free`, {REMEDY}")
    if not inertial:
        raise top.refuse("fall", f"tilt is measured by an IMU: describe it in `sensors.imu`, {REMEDY}")
    section = top.section("fall")
    reaction = FallReaction(given.reaction)
    if reaction is FallReaction.FOLD and given.pose not in poses:
        known = ", ".join(poses)
        raise section.refuse("pose", f"no pose {given.pose!r}; there are {known}: add it, {REMEDY}")
    if not given.upright_rad < given.tilt_rad:
        raise section.refuse(
            "upright_rad", f"{given.upright_rad:g} is not below tilt_rad, {given.tilt_rad:g}"
        )
    return FallSettings(
        reaction,
        given.pose,
        given.outside_m,
        given.after_ms / 1e3,
        given.tilt_rad,
        given.upright_rad,
    )
