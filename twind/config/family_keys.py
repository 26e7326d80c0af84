"""Keys of a robot file that driver families share: of a bus, a type, a joint's slot. Each adds its own."""

from typing import Annotated, Any, Literal

from msgspec import Meta

from twind.config.config_reader import ConfigStruct, Text
from twind.config.supply_limits import HeatKeys, SupplyKeys

Acceleration = Annotated[float, Meta(gt=0.0, le=1e4)]  # rad/s²
MOST_FOLLOW = 1.5  # rad
FollowRad = Annotated[float, Meta(ge=0.02, le=MOST_FOLLOW)]
FollowTime = Annotated[float, Meta(ge=0.02, le=2.0)]  # s
Speed = Annotated[float, Meta(gt=0.0, le=100.0)]  # rad/s


class BusKeys(ConfigStruct):
    """Entry of `buses`, of any kind."""

    kind: Text
    """`dynamixel2`, `dynamixel2_unwatched`, `dynamixel1`, `feetech`, `can` | | driver family, or that of an
    installed package"""
    port: Text | None = None
    """port | | as `ports` of the settings, which override it"""


class TypeKeys(ConfigStruct, kw_only=True):
    """Entry of `types`, of any kind."""

    device: Text
    """model name | | such as XM430-W350, DM4340"""
    mode: Any = None  # a text; `read_mode` explains a number
    """`position`, `extended_position`, `current_based_position`; CAN: `impedance` | `position`; CAN:
    `impedance` | operating mode, register 11: 3, 4 or 5. Only `position` applies the servo's own limits"""
    acceleration_limit_rad_s2: Acceleration = 10.0
    """of the motor shaft"""
    follow_rad: FollowRad | None = None
    """0.02–1.5 | by gain, load and speed, 0.2 to 0.5 | of the joint: further behind its goal is FOLLOW_ERR;
    0.3 further it is damped. `check robot` shows it, `tune follow` proposes it"""
    follow_s: FollowTime | None = None
    """0.02–2 | 0.1 | for so long"""
    supply: SupplyKeys
    heat: HeatKeys


class SlotKeys(ConfigStruct, kw_only=True):
    """Keys of a joint or actuator that say how it is turned; `defaults` may have all but `id`."""

    type: Text
    """type | of `defaults` |"""
    bus: Text
    """bus | of `defaults` |"""
    sign: Literal[1, -1] = 1
    """| of `defaults`, else 1 | -1: the motor turns the other way"""
    ratio: Annotated[float, Meta(gt=0.0, le=1000.0)] = 1.0
    """| of `defaults`, else 1 | motor turns per joint turn"""
    mode: Any = None
    """as of a type | of `defaults`, else its type's |"""
