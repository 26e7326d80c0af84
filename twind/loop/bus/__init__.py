"""Buses of the loop: ports, exchanges, and conversion between counts and radians."""
