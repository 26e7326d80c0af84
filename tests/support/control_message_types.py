"""Types of `control_msgs` for rosbags, whose store has none of them."""

from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore

# As DynamicJointState.msg and InterfaceValue.msg of control_msgs have them.
DYNAMIC_JOINT_STATE = """std_msgs/Header header
string[] joint_names
InterfaceValue[] interface_values
"""
INTERFACE_VALUE = """string[] interface_names
float64[] values
"""


def add_control_types(store: Typestore) -> Typestore:
    """Return `store`, which knows them now."""
    store.register(get_types_from_msg(INTERFACE_VALUE, "control_msgs/msg/InterfaceValue"))
    store.register(get_types_from_msg(DYNAMIC_JOINT_STATE, "control_msgs/msg/DynamicJointState"))
    return store
