"""Assigns a chosen servo to a joint: the steps in their order, and their description. Blocks."""

from dataclasses import asdict, dataclass

from twind.command_line.verb import Rejected
from twind_drivers.servo_tools.adoption.calibration_entry_status import CalibrationEntryStatus
from twind_drivers.servo_tools.adoption.candidate_locations import AdoptionCandidate
from twind_drivers.servo_tools.adoption.register_plan import RegisterStep, different, plan
from twind_drivers.servo_tools.servo_configurator import (
    LOCK,
    TORQUE,
    TORQUE_ON,
    ProberAtRate,
    ServoConfigurator,
)


@dataclass(frozen=True, slots=True)
class AdoptionPlan:
    """Planned changes of one servo, computed before any of them is made. `hand` holds the servo."""

    chosen: AdoptionCandidate
    firmware: int
    steps: tuple[RegisterStep, ...]
    entry: CalibrationEntryStatus
    hand: ServoConfigurator

    @property
    def nothing(self) -> bool:
        """True when the servo answers at the joint's id and rate and has all required settings."""
        return not self.steps and self.chosen.place == self.chosen.home

    def lines(self) -> list[str]:
        """Return the confirmation text: the servo, the values to write, the effect on the calibration."""
        chosen = self.chosen
        joint = self.chosen.joint
        said = [
            f"{chosen.found.model_name}, firmware {self.firmware}, {chosen.place}, torque off",
            f"becomes {joint.name}: {chosen.home} on bus {chosen.bus.name}",
            *(f"  {step}" for step in self.steps),
        ]
        if chosen.place.id != chosen.home.id:
            where = self.hand.table["id"].address
            said.append(f"  id ({where}): {chosen.place.id} -> {chosen.home.id}")
        if chosen.place.baud != chosen.home.baud:
            where = self.hand.table["baud_rate"].address
            said.append(f"  baud rate ({where}): {chosen.place.baud} -> {chosen.home.baud}")
        return [*said, *(f"  {line}" for line in self.entry.lines())]

    def to_json(self, state: str) -> dict[str, object]:
        """Return the plan as data for programs. `state`: planned, adopted or there."""
        chosen = self.chosen
        return {
            "state": state,
            "joint": chosen.joint.name,
            "bus": chosen.bus.name,
            "model": chosen.found.model_name,
            "firmware": self.firmware,
            "from": asdict(chosen.place),
            "to": asdict(chosen.home),
            "registers": [asdict(step) for step in self.steps],
            "calibrated": self.entry.there and state == "there",
        }

    def carry_out(self) -> None:
        """Write, read back, and verify the whole servo at its final id and rate. Raises Rejected, PortError.

        After an interruption at any point, a repeated adoption finds the servo and completes the steps.
        """
        joint = self.chosen.joint
        tools = self.chosen.tools
        known = self.hand.table
        self.entry.strike_out()
        with self.hand.unlocked():
            for step in self.steps:
                if step.register != LOCK:
                    self.hand.write(step.register, step.then)
            self.hand.move(self.chosen.home)
        held = self.hand.read(tools.settings(known))
        if held[TORQUE] or (
            wrong := list(different(joint, tools, known, self.firmware, held, new=self.chosen.new))
        ):
            why = "its torque is on" if held[TORQUE] else "; ".join(wrong)
            raise Rejected(f"{joint.name}, {self.hand.place}: after all was written, {why}")


def prepare(chosen: AdoptionCandidate, at: ProberAtRate, entry: CalibrationEntryStatus) -> AdoptionPlan:
    """Read the servo and compute the necessary writes; writes nothing. Raises Rejected, PortError.

    Also rejected: a servo at the final id and rate whose joint is calibrated. It is presumably the servo of
    that joint, and adoption would discard its calibration.
    """
    model = chosen.found.model
    firmware = chosen.found.firmware
    assert model is not None  # `choose` lets no other pass
    assert firmware is not None
    tools = chosen.tools
    table = tools.table_of(chosen.joint.type.device)
    hand = ServoConfigurator(at, tools, model, table, chosen.place)
    if chosen.place != chosen.home and not hand.is_free(chosen.home):
        raise Rejected(
            f"{chosen.home}, the place of {chosen.joint.name}, is taken after all: its servo answers now and "
            "then only. Look at its cable, or take it off the bus"
        )
    held = hand.read(tools.settings(table))
    if held[TORQUE]:
        raise Rejected(TORQUE_ON.format(chosen.place))
    steps = plan(chosen.joint, tools, table, firmware, held, new=chosen.new)
    if chosen.place == chosen.home and entry.there and steps:
        name = chosen.joint.name
        raise Rejected(
            f"{name} has its servo, {chosen.home}, and its calibration, {entry.path}: nothing to adopt. It "
            f"holds otherwise than the robot file says: {'; '.join(map(str, steps))}: `twindctl doctor` says "
            f"what each needs. If it is another servo than the calibrated one, its zero is another too: take "
            f"{name} out of {entry.path}, then adopt it"
        )
    return AdoptionPlan(chosen, firmware, steps, entry, hand)
