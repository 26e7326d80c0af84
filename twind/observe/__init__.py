"""Observers: recordings, the viewer, metrics, pictures. Clients of the socket, and verbs of `twindctl`."""
