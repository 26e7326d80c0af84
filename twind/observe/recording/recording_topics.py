"""Names in our recordings: topics, attachments, metadata."""

MEASURED = "/hw/joint_states"
SIMULATED = "/sim/joint_states"
COMMANDS = "/hw/joint_commands"
INERTIAL = "/imu"
TRAJECTORY = "/hw/joint_trajectory"
STATUS = "/twind/status"
EVENTS = "/twind/events"
VERDICTS = "/twind/verdicts"
LATENCY = "/twind/latency"
JOINTS = "/twind/joints"
NOTES = "/twind/recording"  # of who recorded: drops, steps of the clock
WIRE = "/twind/wire"  # raw bytes of the buses, out of a flight recorder

ROBOT = "robot.json"
CALIBRATION = "calibration.json"
MJCF = "model.mjcf"

# metadata records
ABOUT = "twind"
EPISODE = "episode"
END = "end"
RECOVERED = "recovered"
