"""Feetech models: number, map, and what a page says of their strength. Pure.

The number tells neither gear nor voltage: all STS3215 report 777. The strength is of a supply voltage.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi

from twind.exceptions import InvalidInput

KG_CM = 0.0980665  # N·m
RPM = pi / 30.0  # rad/s
AMPERE = 0.0065  # A per count of the current register


# The law of the P gain is assumed, as no page gives it: P 32 is as stiff as an XM430 at 800.
GAIN = 25.0  # XM430 gain of a count of P
DIVISOR = 128.0  # output counts for each position count of error: gain / divisor
FULL = 1000.0  # output counts of the whole supply
FACTORY_P = 32  # register 21
STAND_IN = "STS3215"  # model whose figures stand for those of models that no page gives any for


@dataclass(frozen=True, slots=True)
class FeetechModel:
    """One model. `strength`: stall torque (N·m) and speed without load (rad/s) by supply voltage (V)."""

    name: str
    number: int  # as identification reports it
    map: str
    strength: Mapping[float, tuple[float, float]]

    def at(self, volts: float) -> tuple[float, float] | None:
        """Return stall torque and speed at the nearest voltage with figures; None: no page gives any."""
        if not self.strength:
            return None
        return self.strength[min(self.strength, key=lambda each: abs(each - volts))]


def share_per_radian(p: float) -> float:
    """Return the share of the stall torque for each rad of error, with P gain `p` (register 21)."""
    return GAIN * p / DIVISOR / FULL * 4096.0 / (2.0 * pi)


def _strength(**rows: tuple[float, float]) -> dict[float, tuple[float, float]]:
    """Convert rows `v7_4=(kg cm, rpm)`."""
    return {
        float(key[1:].replace("_", ".")): (torque * KG_CM, speed * RPM)
        for key, (torque, speed) in rows.items()
    }


def models() -> dict[str, FeetechModel]:
    """Return the known models by name."""
    # 7.4 V: DFRobot SER0069 and the vendor's memory table; 6 V, 12 V (C018): SO-ARM100 README.
    sts3215 = _strength(v6=(16.5, 42.0), v7_4=(19.5, 52.0), v12=(30.0, 45.0))
    rows = [
        FeetechModel("STS3215", 777, "sts", sts3215),
        FeetechModel("STS3250", 2825, "sts", _strength(v12=(50.0, 75.0))),
        FeetechModel("SCS0009", 1284, "scs", {}),
        FeetechModel("SCS15", 1295, "scs", {}),
        FeetechModel("SCS215", 1315, "scs", {}),
        FeetechModel("SM8512BL", 11272, "smbl", {}),
        FeetechModel("HLS3955", 4874, "hls", {}),
        FeetechModel("HLS3915", 5130, "hls", {}),
    ]
    numbers = {"3015": 265, "3032": 521, "3040": 1033, "3020": 1289, "3046": 1545, "3045": 1801, "3235": 2057}
    rows += [FeetechModel(f"STS{name}", number, "sts", {}) for name, number in numbers.items()]
    return {each.name: each for each in rows}


def model(name: str) -> FeetechModel:
    """Return a model by its name. Raises InvalidInput that lists the names."""
    known = models()
    if name not in known:
        raise InvalidInput(f"{name!r} is no Feetech model known here; known: {', '.join(sorted(known))}")
    return known[name]


def name_of(number: int, map_name: str) -> str | None:
    """Return the name of a model number; None: not known. Numbers are unique only within a map."""
    return next(
        (each.name for each in models().values() if (each.number, each.map) == (number, map_name)), None
    )
