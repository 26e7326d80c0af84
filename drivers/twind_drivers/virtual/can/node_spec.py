"""Description of one virtual CAN actuator as installed."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from twind_drivers.virtual.hinge import Hinge

# How the name of a model begins -> the frames that it speaks.
PREFIXES = {"DM": "damiao", "AK": "cubemars", "RS": "robstride", "EL": "robstride", "CyberGear": "robstride"}
# STRONG: public drivers, unverified
USUAL = (500.0, 5.0)
STRONG = (5000.0, 100.0)
FAMILIES = ("damiao", "cubemars", "robstride", "odrive")


@dataclass(frozen=True, slots=True)
class NodeSpec:
    """Identity of one actuator, and its settings that differ from the factory's.

    `settings`, by family. Damiao: any register by its name, raw. RobStride: any parameter by its name, raw.
    CubeMars: `timeout` s. ODrive: `watchdog_timeout`, `heartbeat`, `estimates` s (0: never), `velocity_limit`
    rev/s, `current_limit` A, `torque_constant` N·m/A, `position_gain`, `velocity_gain`. All: `hottest` °C,
    `lowest`, `highest` V, `boot` s.
    """

    id: int
    model: str
    feedback_id: int = 0  # Damiao: master id (register 7); RobStride: host id, 0 for FD; else unused
    position: float = 12.5  # rad: what its position field spans, both ways
    velocity: float = 30.0  # rad/s
    torque: float = 10.0  # N·m: what the field spans, and the most that it can pull
    firmware: int = 1
    settings: Mapping[str, float] = field(default_factory=dict)
    family: str = ""  # one of FAMILIES; empty: by the model's name
    forgets_zero: bool = False  # a zero that was set over the bus is lost at power-off (CyberGear)
    hinge: Hinge | None = None  # the joint that it turns
    chip: int = 0  # 64-bit number of its processor, which a RobStride reports; 0: one by its id and firmware

    @property
    def number(self) -> int:
        """The 64-bit number of its processor."""
        made = bytes([self.id & 0xFF, self.firmware & 0xFF, 0x30, 0x31, 0x32, 0x33, 0x34, 0x35])
        return self.chip or int.from_bytes(made, "little")

    def gains(self) -> tuple[float, float]:
        """Return the spans, from 0, of its Kp (N·m/rad) and Kd (N·m·s/rad) fields.

        The three big RobStrides have larger ones.
        """
        return STRONG if self.model[:4] in ("RS03", "RS04", "RS06") else USUAL

    def spoken(self) -> str:
        """One of FAMILIES. Raises ValueError for a family or model that is not simulated."""
        if self.family in FAMILIES:
            return self.family
        for prefix, family in [*PREFIXES.items(), ("ODrive", "odrive")]:
            if not self.family and self.model.startswith(prefix):
                return family
        what = self.family or self.model
        raise ValueError(f"node {self.id}: {what!r} is not simulated; families are {', '.join(FAMILIES)}")
