"""Commands from elsewhere to one daemon, as ROS and an uplink use them. Standard library, Python 3.10.

A command is a request with a receiver for its outcome, and each request gets one. `request_queue`: a thread
and a bounded queue for requests of one kind; a full queue refuses at once. `stop_queues`: settle, cut and
hold have a queue each, where one call answers all that wait, so that only the same stop delays a stop.
`leased_motions`: trajectories under the daemon's lease, which lasts while they move. What arrived before a
stop does not begin after it, and each motion is reported to its end.

These modules know no message format, no key, no topic and no remote lease: `ros` and `uplink` convert both
ways. They import `twind.client` and `twind.robot_client`; `ros` and `uplink` import them.
"""
