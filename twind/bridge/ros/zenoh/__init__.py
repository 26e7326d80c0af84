"""ROS 2 over Zenoh, as nodes under `rmw_zenoh_cpp` speak it. Needs the extra `zenoh`.

`names`: keys, tokens, ids · `attachment`: what goes beside a message · `config`: the session ·
`node`: its endpoints · `service`: who answers · `graph`: all of it as a back end.
"""

from twind.bridge.ros.zenoh.zenoh_transport import ZenohTransport

__all__ = ["ZenohTransport"]
