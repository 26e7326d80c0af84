"""The gap between the simulated and the measured robot, as figures per joint."""
