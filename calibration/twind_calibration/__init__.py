"""Setup and diagnosis of a robot before it moves.

Consists of clients of the daemon, and of the port while no daemon runs.
"""
