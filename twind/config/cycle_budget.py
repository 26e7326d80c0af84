"""The cycle of every bus of a robot at a rate: bytes or frames, µs, Hz reachable; or a refusal."""

from twind.config.config_reader import file_error
from twind.config.driver_family import BudgetRequest, CycleBudget, family
from twind.config.robot_spec import RobotFile


def budgets(robot: RobotFile, rate_hz: float) -> tuple[CycleBudget, ...]:
    """The cycle of every bus: goals, reading, upkeep and the adapter's latency. Without joints: none."""
    joints = {bus.name: [joint for joint in robot.joints if joint.bus == bus.name] for bus in robot.buses}
    sensors = {} if robot.imu is None else {robot.imu.bus: robot.imu}
    return tuple(
        family(bus.kind).budget(BudgetRequest(bus, joints[bus.name], rate_hz, sensors.get(bus.name)))
        for bus in robot.buses
        if joints[bus.name]
    )


def require_rate(robot: RobotFile, rate_hz: float) -> tuple[CycleBudget, ...]:
    """`budgets`, every one within reach. Raises ConfigError with the arithmetic of the first that is not."""
    found = budgets(robot, rate_hz)
    for each in found:
        if each.refusal is not None:
            raise file_error(str(robot.path), each.refusal)
    return found
