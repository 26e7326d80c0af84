"""State of the robot at one tick, with the age of every value. Pure."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from html import escape
from math import degrees
from typing import Any

import numpy as np

from twind.command_line.text_table import align_columns, fixed_number
from twind.robot.arrays import Bools, Floats
from twind.robot.joint_map import similar_joints
from twind.robot_client.state_message import StateMessage


@dataclass(frozen=True, slots=True)
class JointReading:
    """One joint at one tick. None: not known."""

    name: str
    position: float | None  # rad
    velocity: float | None  # rad/s
    effort: float | None  # N·m
    goal: float | None  # rad, what the daemon follows now
    torque: bool | None
    temperature: float | None  # °C
    voltage: float | None  # V
    age: float | None  # s since it was read

    @property
    def degrees(self) -> float | None:
        """Position in degrees."""
        return None if self.position is None else degrees(self.position)


class ReadingsByName(dict[str, JointReading]):
    """Joint by name; an unknown name is a KeyError that lists similar ones."""

    def __missing__(self, name: str) -> JointReading:
        raise KeyError(f"no joint {name!r}; {similar_joints(str(name), list(self))}")


@dataclass(frozen=True)
class RobotSnapshot:
    """Every joint at one tick, in the robot's order. Rows are (n,); NaN: not known."""

    names: tuple[str, ...]
    message: StateMessage

    @property
    def stamp(self) -> float:
        """Time of the tick, s of this machine's monotonic clock (`time.monotonic`)."""
        return self.message.time

    @property
    def position(self) -> Floats:
        """Rad; in mode sim of the simulation."""
        return self.message.position

    @property
    def velocity(self) -> Floats:
        """rad/s."""
        return self.message.velocity

    @property
    def goal(self) -> Floats:
        """Rad, what the daemon follows at this tick."""
        return self.message.goal

    @cached_property
    def effort(self) -> Floats:
        """N·m, from the measured current."""
        return np.array([np.nan if row["effort"] is None else row["effort"] for row in self.message.rows])

    @property
    def elapsed(self) -> float:
        """Seconds since the tick, now."""
        return time.monotonic() - self.message.time

    @property
    def age(self) -> Floats:
        """Seconds since each joint was read, now; inf: never."""
        return self.message.age + self.elapsed

    def fresh(self, bound: float = 0.1) -> Bools:
        """Return which joints were read less than `bound` s ago."""
        found: Bools = self.age <= bound
        return found

    @cached_property
    def joints(self) -> Mapping[str, JointReading]:
        """Joint by name."""
        return ReadingsByName({row["name"]: _joint(row) for row in self.message.rows})

    def __str__(self) -> str:
        """Return a table of the joints as text."""
        ages = dict(zip(self.names, self.age.tolist(), strict=True))
        rows = [
            (
                each.name,
                _number(each.position),
                _number(each.goal),
                _number(each.velocity, 2),
                _number(each.effort, 2),
                f"{ages[each.name] * 1e3:.0f}",
            )
            for each in self.joints.values()
        ]
        return "\n".join(
            align_columns([("joint", "rad", "goal", "rad/s", "N·m", "age ms"), *rows], left=(0,))
        )

    def __repr__(self) -> str:
        return f"<RobotSnapshot of {len(self.names)} joints at {self.stamp:.3f} s>"

    def to_html(self) -> str:
        """Return a table for a notebook."""
        ages = dict(zip(self.names, self.age.tolist(), strict=True))
        rows = "".join(
            f"<tr><td>{escape(each.name)}</td><td>{_number(each.position)}</td>"
            f"<td>{_number(each.degrees, 1)}</td><td>{_number(each.goal)}</td>"
            f"<td>{_number(each.effort, 2)}</td><td>{ages[each.name] * 1e3:.0f}</td></tr>"
            for each in self.joints.values()
        )
        head = "".join(f"<th>{name}</th>" for name in ("joint", "rad", "°", "goal", "N·m", "age ms"))
        return f"<table><tr>{head}</tr>{rows}</table>"

    def _repr_html_(self) -> str:
        """Return the table that a notebook shows."""
        return self.to_html()


def _joint(row: Mapping[str, Any]) -> JointReading:
    age = row["age_ms"]
    return JointReading(
        name=row["name"],
        position=row["position"],
        velocity=row["velocity"],
        effort=row["effort"],
        goal=row["goal"],
        torque=row["torque"],
        temperature=row["temperature"],
        voltage=row["voltage"],
        age=None if age is None else age / 1e3,
    )


def _number(value: float | None, digits: int = 3) -> str:
    return fixed_number(value, digits, "–")
