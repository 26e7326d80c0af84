"""Operating modes, units and firmware abilities of each Dynamixel model, from the vendor's manual. Pure.

Source of a model's row: its e-manual page (`page`), the drive mode, startup, bus watchdog and operating mode
sections that all pages share, and "Protocol 2.0" for the instructions. A fact that no page states is None.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import pi

# rad/s: 0.229 and 0.01 rev/min
X_SPEED = 0.229 * 2.0 * pi / 60.0
P_SPEED = 0.01 * 2.0 * pi / 60.0
MAX_OFFSET = 1024  # counts: beyond it position mode ignores a homing offset (e-manual, address 20)
ALL_SIX = frozenset({0, 1, 3, 4, 5, 16})
NO_CURRENT = frozenset({1, 3, 4, 16})  # without current sensing there is neither mode 0 nor 5


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelCapabilities:
    """Facts of one model: modes, units, abilities of its firmware.

    `..._from`: the first firmware version with that ability; 0: every version; None: no page names one.
    """

    modes: frozenset[int] = ALL_SIX  # of register "operating_mode"
    counts_per_turn: int | None = 4096  # of the output; None: the sources disagree, or it is no whole number
    centre: int | None = 2048  # the count that the vendor's scale calls 0 rad
    radians_per_velocity_count: float | None = X_SPEED
    ampere_per_count: float | None = 2.69e-3  # A; None: no current is measured
    effort: str = "present_current"  # or "present_load", 0.1 %
    fast_from: int | None = 45  # fast sync and bulk reads
    watchdog_from: int | None = 38  # bus watchdog
    clear_from: int | None = 42  # instruction clear
    startup_from: int | None = 45  # startup configuration: torque on at boot
    backup_from: int | None = 45  # instruction control table backup
    torque_on_by_goal_from: int | None = 45  # drive mode, bit 3
    volts_per_count: float = 0.1  # of the input voltage register
    offset_limit: int | None = (
        MAX_OFFSET  # homing offset beyond which position mode ignores it; None: no such limit
    )
    keeps_turns: bool = False  # a battery keeps its turn count, and position mode spans many turns
    caps_current: bool = False  # goal current caps the current of position mode; else it counts in 0 and 5
    gear: int = 0  # electronic gear ratio at which the counts are those of the output; 0: no such register
    undriven: str = ""  # why this driver cannot move it; "": it can


X430 = ModelCapabilities()
XH430_V = replace(X430, ampere_per_count=1.34e-3)
XL430 = replace(X430, modes=NO_CURRENT, ampere_per_count=None, effort="present_load")
TWIN = replace(XL430, fast_from=None, startup_from=None, backup_from=None, torque_on_by_goal_from=None)
X330 = ModelCapabilities(
    ampere_per_count=1e-3,
    fast_from=46,
    watchdog_from=0,
    startup_from=46,
    backup_from=46,
    torque_on_by_goal_from=46,
)
MX64 = ModelCapabilities(
    ampere_per_count=3.36e-3, fast_from=None, startup_from=None, backup_from=None, torque_on_by_goal_from=None
)
MX28 = replace(MX64, modes=NO_CURRENT, ampere_per_count=None, effort="present_load")
PH54 = ModelCapabilities(
    modes=frozenset({0, 1, 3, 4, 16}),
    counts_per_turn=1_003_846,
    centre=0,
    radians_per_velocity_count=P_SPEED,
    ampere_per_count=1e-3,
    fast_from=12,
    watchdog_from=0,
    clear_from=None,
    startup_from=None,  # the register exists; the pages name no firmware for it
    backup_from=12,
    torque_on_by_goal_from=None,
)
PH42 = replace(PH54, counts_per_turn=607_500)
PM54 = replace(PH54, counts_per_turn=502_834)
PM42 = replace(PH54, counts_per_turn=526_374)
# The gripper. Its page and the vendor's file disagree: 4096 counts a turn and 0.01 rpm, 4231 and 0.114 rpm.
RH_P12 = replace(
    PH54,
    modes=frozenset({0, 5}),
    counts_per_turn=None,
    centre=None,  # 0 is open, 1150 closed
    radians_per_velocity_count=None,
    fast_from=13,
    backup_from=None,
)
# Y: e-manual, "Operating Mode (33)", "Goal Current (526)", "Present Input Voltage (568)", "Electronic Gear
# Ratio (96, 100)". Which firmware has fast reads is not stated.
YM = ModelCapabilities(
    modes=frozenset({0, 1, 3}),
    counts_per_turn=524_288,
    centre=0,
    radians_per_velocity_count=P_SPEED,
    ampere_per_count=0.01,
    fast_from=None,
    watchdog_from=0,
    clear_from=0,
    startup_from=0,
    backup_from=None,
    torque_on_by_goal_from=None,
    volts_per_count=0.01,
    offset_limit=None,
    keeps_turns=True,
    caps_current=True,
)
XL320 = ModelCapabilities(
    modes=frozenset(),
    counts_per_turn=None,  # 1024 in 300 degrees: 1228.8
    centre=512,
    radians_per_velocity_count=0.111 * 2.0 * pi / 60.0,
    ampere_per_count=None,
    effort="present_load",
    fast_from=None,
    watchdog_from=None,
    clear_from=None,
    startup_from=None,
    backup_from=None,
    torque_on_by_goal_from=None,
    undriven="it has no bus watchdog: use a bus of kind dynamixel2_unwatched",
)


def _advanced(p_series: ModelCapabilities) -> ModelCapabilities:
    """Return the PRO -R(A) of the same drive train: the P series' layout without registers 13 and 60."""
    return replace(p_series, fast_from=None, backup_from=None)


# The XW, XD and 540 have the facts of the X430 with current sensing.
PLAIN = (
    *("xm430_w210", "xm430_w350", "xh430_w210", "xh430_w350", "xd430_t210", "xd430_t350", "xw430_t333"),
    *("xm540_w150", "xm540_w270", "xh540_w150", "xh540_w270", "xh540_v150", "xh540_v270"),
    *("xd540_t150", "xd540_t270", "xw540_t140", "xw540_t260", "xw540_h260"),
)
SMALL = ("xl330_m077", "xl330_m288", "xc330_t181", "xc330_t288", "xc330_m181", "xc330_m288")
Y_SIZES = ("ym070_210", "ym080_230")
Y_GEARS = {"m001": 1, "b001": 1, "r051": 51, "r099": 99, "a051": 51, "a099": 99}

FACTS: Mapping[str, ModelCapabilities] = {
    **dict.fromkeys(PLAIN, X430),
    **dict.fromkeys(("xh430_v210", "xh430_v350"), XH430_V),
    **dict.fromkeys(("xl430_w250", "xc430_w150", "xc430_w240"), XL430),
    **dict.fromkeys(("2xl430_w250", "2xc430_w250"), TWIN),
    **dict.fromkeys(SMALL, X330),
    **{"mx_28": MX28, "mx_64": MX64, "mx_106": MX64},
    **{"ph42_020_s300": PH42, "ph54_100_s500": PH54, "ph54_200_s500": PH54},
    **{"pm42_010_s260": PM42, "pm54_040_s250": PM54, "pm54_060_s250": PM54},
    **{"h42_20_s300_ra": _advanced(PH42), "m42_10_s260_ra": _advanced(PM42)},
    **dict.fromkeys(("h54_100_s500_ra", "h54_200_s500_ra"), _advanced(PH54)),
    **dict.fromkeys(("m54_40_s250_ra", "m54_60_s250_ra"), _advanced(PM54)),
    "rh_p12_rn": RH_P12,
    # The pages of the M001, R051 and R099 were read: the facts of the B001, A051 and A099 are assumed.
    **{f"{size}_{end}": replace(YM, gear=gear) for size in Y_SIZES for end, gear in Y_GEARS.items()},
    "xl320": XL320,
}


def base(stem: str) -> str:
    """Return the model of a table's file. X330 from firmware 52 have their own file, with the same facts."""
    return stem.removesuffix("_fw52")


def facts(stem: str) -> ModelCapabilities:
    """Return the facts of the model whose table is `stem` ("xm430_w350").

    Raises KeyError for a model whose page has not been read.
    """
    found = FACTS.get(base(stem))
    if found is None:
        raise KeyError(f"no facts about the model of table {stem!r}: its manual page has not been read")
    return found


def page(stem: str) -> str:
    """Return the path of the model's manual page below emanual.robotis.com/docs/en/."""
    name = base(stem).replace("_", "-")
    if name == "rh-p12-rn":
        return "platform/rh_p12_rna/"
    if name.startswith("mx"):
        return f"dxl/mx/{name}-2/"
    if name.endswith("-ra"):
        return f"dxl/pro/{name}/"
    if name.startswith("ym"):
        return f"dxl/y/{name}-rh/"
    return f"dxl/p/{name}-r/" if name.startswith("p") else f"dxl/x/{name}/"
