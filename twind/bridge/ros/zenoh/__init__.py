"""ROS 2 over Zenoh, in the form of nodes under `rmw_zenoh_cpp`. Needs the extra `zenoh`.

`zenoh_names`: keys, tokens, ids · `zenoh_attachment`: data beside a message · `zenoh_config`: the session ·
`zenoh_node`: its endpoints · `zenoh_service`: services · `zenoh_transport`: all of it as a back end.
"""

from twind.bridge.ros.zenoh.zenoh_transport import ZenohTransport

__all__ = ["ZenohTransport"]
