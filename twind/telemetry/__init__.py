"""Timing of readings and commands: rolling statistics and latency tracing. Pure: no I/O, no clock."""
