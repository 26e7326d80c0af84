"""A recording played back: its devices on pseudo-terminals, a daemon before them, what comes out compared.

Upwards: `wire` (bytes to exchanges), `story` (what they tell of the devices), `servos` and `bus` (devices
that answer as it says), `outcome` (what came of commands), `score` (what was asked, and what came of it),
`stage` and `conductor` (a daemon of its own, and its clients).
"""
