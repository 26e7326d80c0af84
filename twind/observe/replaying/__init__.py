"""Replay of a recording: its devices on pseudo-terminals, a daemon before them, and a comparison of results.

Upwards: `recorded_exchanges` (bytes to exchanges), `device_timeline` (changes of devices), `replay_servos`
and `replay_bus` (devices that answer so), `replay_outcome` (results of commands), `replay_script` (commands
and their results), `replay_daemon` and `replay_client` (a daemon of its own, and its clients).
"""
