"""Uplink of one robot: state out over Zenoh, goals in. A client of the socket, beside the daemon."""
