"""Environments of one robot for Gymnasium: in simulation, or through the daemon."""
