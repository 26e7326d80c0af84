"""The twin: mirror of the measured robot and simulation of the commanded one, in the loop's thread."""

from twind.robot.arrays import Floats
from twind.robot.joint_state import JointState
from twind.twin.binding import Binding
from twind.twin.contacts import Contact
from twind.twin.mirror import TwinMirror
from twind.twin.simulation import Simulation, hush


class Twin:
    """Mirror and simulation, each on its own copy of the model. Arrays are (n,) in joint order."""

    def __init__(self, binding: Binding, period: float) -> None:
        """`period`: s, of one tick. The simulation starts at the rest pose."""
        hush()
        self.mirror = TwinMirror(binding)
        self.simulation = Simulation(binding, period)

    def take_gains(self, binding: Binding) -> None:
        """Use the servos of `binding`, the same robot with other gains, from now on."""
        self.simulation.take_gains(binding)

    @property
    def resets(self) -> int:
        """Times the simulation broke down and was reset to its last good pose."""
        return self.simulation.resets

    def update(self, measured: JointState | None, goal: Floats | None, now: float) -> JointState:
        """Mirror a reading, simulate one period, return the simulated state.

        None: no reading, no new goal. Only finite numbers enter either model.
        """
        if measured is not None:
            self.mirror.update(measured)
        self.simulation.step(goal)
        return self.simulation.state(now)

    def contact(self, joint: int) -> Contact | None:
        """Return the deepest simulated contact that keeps `joint` from turning; None: there is none."""
        return self.simulation.contact(joint)

    def place(self, position: Floats) -> None:
        """Start the simulation anew at `position` (n,), rad, at rest, holding there."""
        self.simulation.place(position)

    def halt(self) -> None:
        """Stop the simulation (its e-stop): goals are not taken until `place` or `release`."""
        self.simulation.halt()

    @property
    def halted(self) -> bool:
        """True after `halt`: goals are not taken."""
        return self.simulation.frozen

    def release(self) -> None:
        """Take goals again after `halt`."""
        self.simulation.release()
