"""Types of the stand-in."""

from stand_in_messages import message

Log = message("rcl_interfaces/msg/Log")
ParameterDescriptor = message("rcl_interfaces/msg/ParameterDescriptor")
SetParametersResult = message("rcl_interfaces/msg/SetParametersResult")
Parameter = message("rcl_interfaces/msg/Parameter")
ParameterValue = message("rcl_interfaces/msg/ParameterValue")
