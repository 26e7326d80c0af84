"""Zenoh as twind uses it: sessions, and the keys of robots. `zenoh` is imported in `bridge` alone."""
