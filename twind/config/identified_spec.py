"""The nouns of an identified model: measured parameters of one robot's joints and bodies. Frozen.

Each value is an estimate with its uncertainty and its prior, so that nobody takes an assumption for a
measurement. `identified_file.py` reads and writes the file.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from math import isnan
from typing import Annotated

from msgspec import Meta

NotNegative = Annotated[float, Meta(ge=0.0, le=1e6)]
Coordinate = Annotated[float, Meta(ge=-10.0, le=10.0)]  # m
# Least and largest value of a parameter, in its unit; beyond them a simulation breaks down or needs a memory
# of goals that no servo has.
BOUNDS: Mapping[str, tuple[float, float]] = {
    "stiffness_nm_per_rad": (1e-6, 1e5),
    "damping_nm_s_per_rad": (0.0, 1e4),
    "friction_nm": (0.0, 1e3),
    "stribeck_nm": (0.0, 1e3),
    "load_friction_per_nm": (0.0, 1e3),
    "armature_kg_m2": (0.0, 1e2),
    "delay_s": (0.0, 0.5),
    "dead_band_rad": (0.0, 0.5),
    "backlash_rad": (0.0, 0.5),
    "sag_per_nm": (0.0, 1e2),
    "mass_kg": (1e-6, 1e4),
}


@dataclass(frozen=True, slots=True)
class ParameterEstimate:
    """One parameter: estimate and prior, each with a standard deviation, in the parameter's unit."""

    value: NotNegative
    sd: NotNegative
    prior: NotNegative
    prior_sd: NotNegative
    determined: bool = True  # False: the data say nothing of it, so `value` is the prior


@dataclass(frozen=True, slots=True)
class PositionEstimate:
    """Centre of mass in the axes of its body, m (3,); prior and standard deviations alike."""

    value: tuple[Coordinate, Coordinate, Coordinate]
    sd: tuple[NotNegative, NotNegative, NotNegative]
    prior: tuple[Coordinate, Coordinate, Coordinate]


@dataclass(frozen=True, slots=True)
class GapReference:
    """Error of the simulation on motion that the fit did not see; see `docs/gap.md`."""

    spread: NotNegative  # share of the spread of the measured position
    unexplained: NotNegative  # share of what the delayed goal leaves unexplained
    effort: NotNegative | None = None  # share of the measured effort; None: not measured
    effort_nm: NotNegative | None = None  # rms error of the effort, N·m


@dataclass(frozen=True, slots=True)
class IdentifiedJoint:
    """Parameters of one joint and its servo. None: not identified, as in the model."""

    stiffness_nm_per_rad: ParameterEstimate | None = None  # of the position servo at its nominal supply
    damping_nm_s_per_rad: ParameterEstimate | None = None  # with torque on: back-EMF and viscous friction
    friction_nm: ParameterEstimate | None = None  # Coulomb
    stribeck_nm: ParameterEstimate | None = None  # more friction near rest
    load_friction_per_nm: ParameterEstimate | None = None  # N·m per (N·m)² that the gear carries
    armature_kg_m2: ParameterEstimate | None = None
    delay_s: ParameterEstimate | None = None  # of the goal
    dead_band_rad: ParameterEstimate | None = None  # whole width: an error inside gives no torque
    backlash_rad: ParameterEstimate | None = None  # whole width, between encoder and joint
    sag_per_nm: ParameterEstimate | None = None  # share of the supply lost per N·m of the motor
    p_gain: Annotated[float, Meta(gt=0.0, le=1e6)] | None = None  # of the servo then; None: unknown
    gap: GapReference | None = None

    def at_gain(self, p_gain: float) -> "IdentifiedJoint":
        """Return the joint with its stiffness at another P gain; as it is where one of them is unknown."""
        stiffness = self.stiffness_nm_per_rad
        if stiffness is None or self.p_gain is None or isnan(p_gain) or p_gain == self.p_gain:
            return self
        ratio = p_gain / self.p_gain
        scaled = {name: ratio * getattr(stiffness, name) for name in ("value", "sd", "prior", "prior_sd")}
        return replace(self, stiffness_nm_per_rad=replace(stiffness, **scaled))

    def value(self, name: str) -> float | None:
        """Return the estimate of the parameter `name`; None: not identified."""
        found: ParameterEstimate | None = getattr(self, name)
        return None if found is None else found.value

    def estimates(self) -> dict[str, ParameterEstimate]:
        """Return the identified parameters by name, in the order of the fields."""
        found = {name: getattr(self, name) for name in PARAMETERS}
        return {name: each for name, each in found.items() if each is not None}


PARAMETERS: tuple[str, ...] = tuple(
    each.name for each in fields(IdentifiedJoint) if each.name not in ("p_gain", "gap")
)


@dataclass(frozen=True, slots=True)
class IdentifiedBody:
    """Mass of one body of the model. None: not identified."""

    mass_kg: ParameterEstimate | None = None
    com_m: PositionEstimate | None = None


@dataclass(frozen=True, slots=True)
class IdentifiedModel:
    """Identified parameters of one robot; joints and bodies by name."""

    robot: str
    created: str
    tool: str
    source: str  # of the data, for people
    seconds: float  # of the data
    held_out: float  # share of the data that judged the fit
    joints: Mapping[str, IdentifiedJoint] = field(default_factory=dict)
    bodies: Mapping[str, IdentifiedBody] = field(default_factory=dict)

    def estimates(self, parameter: str) -> dict[str, ParameterEstimate]:
        """Return the estimates of one parameter, by joint; joints without it are left out."""
        found = {name: getattr(joint, parameter) for name, joint in self.joints.items()}
        return {name: each for name, each in found.items() if each is not None}
