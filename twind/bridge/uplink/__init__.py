"""One robot beyond its machine: state out over Zenoh, goals in. A client of the socket, beside the daemon."""
