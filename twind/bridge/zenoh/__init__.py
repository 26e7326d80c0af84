"""Zenoh sessions and keys of robots. `zenoh` is imported in `bridge` alone."""
