"""Records of `ros2_control` sections: drivers of Dynamixel servos, transmissions, wrong numbers."""

import pytest

from twind.exceptions import InvalidInput
from twind_calibration.model_import.imported_model import HardwareSystem, RemarkList
from twind_calibration.model_import.ros2_control_reader import read_hardware
from twind_calibration.model_import.xml_tree import parse_xml

JOINT_IDS = """
<robot name="r">
  <ros2_control name="arm" type="system">
    <hardware><plugin>dynamixel_hardware/DynamixelHardware</plugin>
      <param name="usb_port">/dev/ttyACM0</param><param name="baud_rate">57600</param></hardware>
    <joint name="a"><param name="id">7</param><param name="model">XL430-W250</param>
      <command_interface name="position"/><command_interface name="velocity"/></joint>
    <transmission name="t"><plugin>transmission_interface/SimpleTransmission</plugin>
      <joint name="a"><mechanical_reduction>2.0</mechanical_reduction><offset>0.5</offset></joint>
      <actuator name="m"><mechanical_reduction>-1.5</mechanical_reduction></actuator>
    </transmission>
  </ros2_control>
</robot>
"""
LINKAGE = """
<robot name="r">
  <ros2_control name="ankle">
    <hardware><param name="transmission_to_joint_matrix">0.5, 0.5, 1, 0</param></hardware>
    <joint name="pitch"/><joint name="roll"/>
    <gpio name="m1"><param name="ID">1</param></gpio><gpio name="m2"><param name="ID">2</param></gpio>
  </ros2_control>
</robot>
"""


def read_one(text: str, remarks: RemarkList | None = None) -> HardwareSystem:
    (system,) = read_hardware(parse_xml(text.encode(), "r.urdf"), remarks or RemarkList())
    return system


def test_ids_of_joints_and_reductions_of_transmissions_are_read() -> None:
    system = read_one(JOINT_IDS)
    assert (system.port, system.baud, system.plugin) == (
        "/dev/ttyACM0",
        57_600,
        "dynamixel_hardware/DynamixelHardware",
    )
    (joint,) = system.joints
    assert (joint.id, joint.model, joint.device) == (7, "XL430-W250", "a")
    assert (joint.reduction, joint.offset) == (-3.0, 0.5)
    assert joint.commands == ("position", "velocity")
    assert joint.place == "r.urdf:6:5"


def test_a_joint_of_two_servos_is_left_out_with_a_remark() -> None:
    remarks = RemarkList()
    pitch, roll = read_one(LINKAGE, remarks).joints
    assert (pitch.id, roll.id) == (None, 1)
    assert [str(remark) for remark in remarks.entries] == [
        "r.urdf:5:5: joint 'pitch' is driven by m1, m2: a linkage, not read"
    ]


@pytest.mark.parametrize("wrong", ["x", "-1", "1.5", "1" * 20])
def test_an_id_that_is_no_number_is_refused(wrong: str) -> None:
    with pytest.raises(InvalidInput, match=r"^r.urdf:6:5: id .* is no whole number from 0; correct it"):
        read_one(JOINT_IDS.replace(">7<", f">{wrong}<"))
