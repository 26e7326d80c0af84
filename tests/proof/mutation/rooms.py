"""Mutated modules, which must be covered whole, and the tests of their room that must notice."""

from dataclasses import dataclass
from pathlib import Path

HOME = Path(__file__).parents[3]


@dataclass(frozen=True, slots=True)
class Room:
    """Modules that are tested together. Paths from the repository's root."""

    name: str
    modules: tuple[str, ...]
    tests: tuple[str, ...]


ROOMS = (
    Room(
        "states",
        ("twind/safety/state_machine.py",),
        ("tests/safety/test_state_machine.py",),
    ),
    Room(
        "lease",
        ("twind/safety/lease.py",),
        ("tests/safety/test_lease.py",),
    ),
    Room(
        "latency",
        (
            "twind/safety/latency_alarm.py",
            "twind/telemetry/command_latency.py",
        ),
        (
            "tests/safety/test_latency_alarm.py",
            "tests/telemetry/test_command_latency.py",
        ),
    ),
    Room(
        "codec",
        (
            "drivers/twind_drivers/dynamixel/packet.py",
            "drivers/twind_drivers/dynamixel/crc.py",
            "drivers/twind_drivers/dynamixel/goal_packets.py",
            "drivers/twind_drivers/dynamixel/command_packet_check.py",
        ),
        (
            "tests/drivers/test_packet.py",
            "tests/drivers/test_packet_framer.py",
            "tests/drivers/test_crc.py",
            "tests/drivers/test_goal_packets.py",
            "tests/drivers/test_command_packet_check.py",
        ),
    ),
    Room(
        "gate",
        (
            "twind/safety/gate.py",
            "twind/safety/gate_types.py",
            "twind/safety/admission.py",
            "twind/safety/curve_rules.py",
            "twind/safety/bernstein_curve.py",
            "twind/safety/polynomial_bounds.py",
            "twind/safety/trajectory_validation.py",
            "twind/safety/retime.py",
            "twind/safety/setpoint_gate.py",
            "twind/safety/headroom.py",
        ),
        (
            "tests/safety/test_gate.py",
            "tests/safety/test_gate_findings.py",
            "tests/safety/test_gate_edges.py",
            "tests/safety/test_trajectory_validation_edges.py",
            "tests/safety/test_curve_rules.py",
            "tests/safety/test_bernstein_curve.py",
            "tests/safety/test_polynomial_bounds.py",
            "tests/safety/test_trajectory_validation.py",
            "tests/safety/test_retime.py",
            "tests/safety/test_setpoint_gate.py",
            "tests/safety/test_headroom.py",
        ),
    ),
    Room(
        "guard",
        (
            "twind/safety/guard.py",
            "twind/safety/guard_types.py",
            "twind/safety/goal_rules.py",
            "twind/safety/joint_reading_rules.py",
            "twind/safety/bus_rules.py",
            "twind/safety/device_rules.py",
            "twind/safety/plausibility_filter.py",
            "twind/safety/heat_rules.py",
            "twind/safety/can_line_rules.py",
            "twind/safety/clearance_rules.py",
            "twind/safety/power_rules.py",
            "twind/safety/stall_rules.py",
            "twind/safety/tracking_rules.py",
        ),
        (
            "tests/safety/test_guard.py",
            "tests/safety/test_guard_findings.py",
            "tests/safety/test_goal_rules.py",
            "tests/safety/test_bus_rules.py",
            "tests/safety/test_device_rules.py",
            "tests/safety/test_plausibility_filter.py",
            "tests/safety/test_heat_rules.py",
            "tests/safety/test_can_line_rules.py",
            "tests/safety/test_clearance_rules.py",
            "tests/safety/test_power_rules.py",
            "tests/safety/test_stall_rules.py",
            "tests/safety/test_tracking_rules.py",
            "tests/safety/test_tracking_rules_transmission.py",
            "tests/safety/test_support_rules.py",
            "tests/safety/test_lead_rules.py",
            "tests/safety/test_fall_rules.py",
            "tests/safety/test_contact_rules.py",
        ),
    ),
    Room(
        "fall",
        (
            "twind/safety/contact_rules.py",
            "twind/safety/fall_rules.py",
            "twind/safety/capture_point.py",
        ),
        (
            "tests/safety/test_contact_rules.py",
            "tests/safety/test_fall_rules.py",
            "tests/safety/test_capture_point.py",
        ),
    ),
    Room(
        "attitude",
        ("twind/robot/attitude.py",),
        ("tests/robot/test_attitude.py",),
    ),
    Room(
        "sensor",
        ("drivers/twind_drivers/register_sensor.py",),
        ("tests/drivers/test_register_sensor.py",),
    ),
    Room(
        "checksum",
        (
            "drivers/twind_drivers/half_duplex/checksum_packet.py",
            "drivers/twind_drivers/half_duplex/checksum_reply.py",
            "drivers/twind_drivers/half_duplex/goal_bounds.py",
            "drivers/twind_drivers/half_duplex/goal_words.py",
            "drivers/twind_drivers/half_duplex/register_write_check.py",
            "drivers/twind_drivers/half_duplex/register_writer.py",
            "drivers/twind_drivers/half_duplex/signed_words.py",
        ),
        (
            "tests/drivers/test_checksum_reply.py",
            "tests/drivers/test_register_write_check.py",
            "tests/drivers/test_feetech_packet.py",
            "tests/drivers/test_feetech_bus.py",
            "tests/drivers/test_dynamixel1_bus.py",
            "tests/drivers/test_unwatched_bus.py",
            "tests/drivers/test_register_writers.py",
            "tests/drivers/test_register_writer_edges.py",
            "tests/drivers/test_gains_after_damping.py",
            "tests/drivers/test_driver_contract.py",
        ),
    ),
    Room(
        "feetech",
        (
            "drivers/twind_drivers/feetech/feetech_packet.py",
            "drivers/twind_drivers/feetech/feetech_writer.py",
            "drivers/twind_drivers/feetech/feetech_registers.py",
        ),
        (
            "tests/drivers/test_feetech_packet.py",
            "tests/drivers/test_feetech_bus.py",
            "tests/drivers/test_servo_register_maps.py",
            "tests/drivers/test_register_writers.py",
            "tests/drivers/test_driver_contract.py",
        ),
    ),
    Room(
        "plausibility",
        ("drivers/twind_drivers/half_duplex/position_plausibility.py",),
        ("tests/drivers/test_position_plausibility.py",),
    ),
    Room(
        "readings",
        ("twind/loop/bus/joint_readings.py", "twind/loop/bus/raw_counts.py"),
        (
            "tests/loop/test_linked_readings.py",
            "tests/loop/test_raw_counts.py",
            "tests/loop/test_joint_readings.py",
            "tests/loop/test_multiturn_counts.py",
            "tests/twin/test_transmission_binding.py",
        ),
    ),
    Room(
        "turns",
        ("twind/safety/multiturn.py",),
        ("tests/safety/test_multiturn.py",),
    ),
    Room(
        "stopped",
        ("twind/safety/stopped_stream.py",),
        ("tests/safety/test_stopped_stream.py",),
    ),
    Room(
        "dynamixel1",
        (
            "drivers/twind_drivers/dynamixel1/dynamixel1_packet.py",
            "drivers/twind_drivers/dynamixel1/dynamixel1_writer.py",
            "drivers/twind_drivers/dynamixel1/dynamixel1_registers.py",
        ),
        (
            "tests/drivers/test_dynamixel1_bus.py",
            "tests/drivers/test_servo_register_maps.py",
            "tests/drivers/test_register_writers.py",
            "tests/drivers/test_driver_contract.py",
        ),
    ),
    Room(
        "hostwatchdog",
        ("drivers/twind_drivers/half_duplex/host_watchdog.py",),
        ("tests/drivers/test_host_watchdog.py",),
    ),
    Room(
        "servocheck",
        ("drivers/twind_drivers/dynamixel/servo_check.py",),
        (
            "tests/drivers/test_servo_check.py",
            "tests/config/test_device_check.py",
            "tests/config/test_device_check_twins.py",
        ),
    ),
    Room(
        "unwatched",
        (
            "drivers/twind_drivers/dynamixel2_unwatched/unwatched_packets.py",
            "drivers/twind_drivers/dynamixel2_unwatched/unwatched_writer.py",
        ),
        (
            "tests/drivers/test_unwatched_bus.py",
            "tests/drivers/test_register_writers.py",
            "tests/drivers/test_driver_contract.py",
        ),
    ),
    Room(
        "mit",
        (
            "drivers/twind_drivers/can/mit_frame.py",
            "drivers/twind_drivers/can/mit_codec.py",
            "drivers/twind_drivers/can/cubemars_codec.py",
        ),
        (
            "tests/drivers/test_mit_frame.py",
            "tests/drivers/test_cubemars_codec.py",
            "tests/drivers/test_damiao_codec.py",
        ),
    ),
    Room(
        "damiao",
        ("drivers/twind_drivers/can/damiao_codec.py",),
        ("tests/drivers/test_damiao_codec.py", "tests/drivers/test_can_register_tables.py"),
    ),
    Room(
        "odrive",
        ("drivers/twind_drivers/can/odrive_codec.py",),
        ("tests/drivers/test_odrive_codec.py", "tests/drivers/test_can_register_tables.py"),
    ),
    Room(
        "robstride",
        ("drivers/twind_drivers/can/robstride_codec.py",),
        ("tests/drivers/test_robstride_codec.py", "tests/drivers/test_can_register_tables.py"),
    ),
    Room(
        "canwriter",
        (
            "drivers/twind_drivers/can/command_frames.py",
            "drivers/twind_drivers/can/command_frame_check.py",
            "drivers/twind_drivers/can/can_writer.py",
            "drivers/twind_drivers/can/can_torque.py",
        ),
        (
            "tests/drivers/test_can_commands.py",
            "tests/drivers/test_can_command_frames.py",
            "tests/drivers/test_command_frame_check.py",
            "tests/drivers/test_can_writer.py",
            "tests/drivers/test_can_torque.py",
            "tests/drivers/test_can_torque_orders.py",
            "tests/drivers/test_can_bus.py",
            "tests/drivers/test_driver_contract.py",
        ),
    ),
    Room(
        "canread",
        ("drivers/twind_drivers/can/can_cyclic_read.py",),
        (
            "tests/drivers/test_can_cyclic_read.py",
            "tests/drivers/test_can_silence.py",
            "tests/drivers/test_can_command_frames.py",
        ),
    ),
    Room(
        "follow",
        ("twind/safety/follow_bounds.py",),
        ("tests/safety/test_follow_bounds.py",),
    ),
    Room(
        "leads",
        ("twind/safety/lead_rules.py",),
        ("tests/safety/test_lead_rules.py",),
    ),
    Room(
        "torque",
        (
            "twind/loop/procedures/torque_state.py",
            "twind/loop/procedures/procedure_runner.py",
        ),
        (
            "tests/loop/test_torque_state.py",
            "tests/loop/test_procedure_runner.py",
        ),
    ),
    Room(
        "arming",
        ("twind/loop/procedures/arming.py",),
        ("tests/loop/test_arming_steps.py", "tests/loop/test_limp_joint_steps.py"),
    ),
    Room(
        "release",
        (
            "twind/loop/procedures/torque_release.py",
            "twind/loop/procedures/daemon_shutdown.py",
            "twind/loop/procedures/torque_takeover.py",
            "twind/loop/procedures/lowering.py",
            "twind/loop/procedures/damping.py",
            "twind/loop/procedures/torque_switching.py",
            "twind/loop/procedures/torque_readback.py",
        ),
        (
            "tests/loop/test_torque_release_steps.py",
            "tests/loop/test_daemon_shutdown_steps.py",
            "tests/loop/test_torque_takeover.py",
            "tests/loop/test_takeover_errors.py",
            "tests/loop/test_lowering.py",
            "tests/loop/test_torque_switching.py",
            "tests/loop/test_fold_and_stop_requests.py",
        ),
    ),
    Room(
        "failsafe",
        ("twind/loop/procedures/failsafe.py",),
        (
            "tests/loop/test_failsafe_steps.py",
            "tests/loop/test_failsafe_refusals.py",
            "tests/loop/test_headless_link.py",
        ),
    ),
    Room(
        "reactions",
        (
            "twind/loop/tick/reactions.py",
            "twind/loop/procedures/internal_faults.py",
            "twind/loop/procedures/estop_replies.py",
            "twind/loop/procedures/robot_condition.py",
        ),
        (
            "tests/loop/test_reaction_steps.py",
            "tests/loop/test_estop_replies.py",
            "tests/loop/test_robot_condition.py",
        ),
    ),
    Room(
        "executor",
        (
            "twind/motion/trajectory_executor.py",
            "twind/motion/stop_profiles.py",
            "twind/motion/limp_joints.py",
            "twind/motion/setpoint_stream.py",
        ),
        (
            "tests/motion/test_trajectory_executor.py",
            "tests/motion/test_executor_give_way.py",
            "tests/motion/test_executor_motion_end.py",
            "tests/motion/test_executor_time_scaling.py",
            "tests/motion/test_stop_profiles.py",
            "tests/motion/test_limp_joints.py",
            "tests/motion/test_setpoint_stream.py",
        ),
    ),
    Room(
        "layers",
        ("twind/motion/motion_layers.py", "twind/motion/settle.py"),
        ("tests/motion/test_motion_layers.py", "tests/motion/test_settle.py"),
    ),
    Room(
        "writer",
        ("drivers/twind_drivers/dynamixel/dynamixel_writer.py",),
        (
            "tests/drivers/test_dynamixel_writer.py",
            "tests/drivers/test_dynamixel_writer_edges.py",
            "tests/drivers/test_operating_modes.py",
            "tests/drivers/test_damping.py",
            "tests/drivers/test_single_servo.py",
            "tests/drivers/test_ram_restore.py",
            "tests/drivers/test_y_series.py",
        ),
    ),
    Room(
        "modes",
        (
            "drivers/twind_drivers/dynamixel/damping.py",
            "drivers/twind_drivers/dynamixel/ram_restore.py",
            "drivers/twind_drivers/dynamixel/operating_modes.py",
        ),
        (
            "tests/drivers/test_damping.py",
            "tests/drivers/test_ram_restore.py",
            "tests/drivers/test_operating_mode_rules.py",
            "tests/drivers/test_operating_modes.py",
            "tests/drivers/test_y_series.py",
        ),
    ),
    Room(
        "homing",
        ("twind/motion/endstop_search.py",),
        (
            "tests/motion/test_endstop_search.py",
            "tests/motion/test_endstop_search_edges.py",
            "tests/motion/test_endstop_search_end.py",
        ),
    ),
)


def importable(module: str) -> str:
    """The dotted name of a module's path."""
    return module.removeprefix("drivers/").removesuffix(".py").replace("/", ".")


def rooms_of(names: list[str]) -> list[tuple[Room, tuple[str, ...]]]:
    """Rooms with the modules chosen by name of room, path or end of a path; all where none is given."""
    chosen = []
    for room in ROOMS:
        modules = tuple(
            module
            for module in room.modules
            if not names or room.name in names or any(module.endswith(name) for name in names)
        )
        chosen += [(room, modules)] if modules else []
    known = {room.name for room in ROOMS} | {module for room in ROOMS for module in room.modules}
    for name in names:
        if not any(each.endswith(name) for each in known):
            raise SystemExit(f"no room or module {name!r}; rooms: {', '.join(room.name for room in ROOMS)}")
    return chosen
