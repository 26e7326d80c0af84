"""Small files of robots, as other software writes them: one motor each, from public descriptions."""

POPPY = {
    "controllers": {"main": {"port": "auto", "attached_motors": ["all"]}},
    "motorgroups": {"all": ["head_y"]},
    "motors": {
        "head_y": {
            "id": 37,
            "type": "AX-12",
            "orientation": "indirect",
            "angle_limit": [-40, 8],
            "offset": 20,
        }
    },
}
LEROBOT = {"pan": {"id": 1, "drive_mode": 1, "homing_offset": -12, "range_min": 800, "range_max": 3200}}
TODDLER = {
    "general": {"dynamixel_baudrate": 2_000_000},
    "joints": {
        "neck": {
            **{"id": 3, "spec": "XC330", "lower_limit": -0.5, "upper_limit": 0.7, "is_passive": False},
            **{"gear_ratio": 1.857, "control_mode": "extended_position", "kp_real": 2400},
        },
        "neck_driven": {"is_passive": True},
    },
}
ROBOTIS = """
[ control info ]
control_cycle = 8   # milliseconds
[ port info ]
/dev/ttyUSB0 | 2000000 | r_sho
[ device info ]
# TYPE    | PORT         | ID | MODEL | PROTOCOL | DEV NAME
dynamixel | /dev/ttyUSB0 | 7  | MX-28 | 2.0      | r_sho   | present_position
sensor    | /dev/ttyUSB0 | 200 | OPEN-CR | 2.0   | open-cr | button, present_voltage
"""
ROBOTIS_INIT = "r_sho: {return_delay_time: 10, min_position_limit: 1024, max_position_limit: 3072}\n"
INTERBOTIX = "motors:\n  waist: {ID: 1, Drive_Mode: 1, Min_Position_Limit: 0, Max_Position_Limit: 4095}\n"
REACHY = """
serial: {port: /dev/ttyACM0, baudrate: 1000000}
motors:
  - body_rotation: {id: 10, angle_limit_min: 100, angle_limit_max: 4000}
"""
