"""Proof of a joint's sign, place and zero by gravity load. A client of the daemon."""
