"""The MuJoCo twin: mirror of the measured robot, simulation of the commanded one, muscles."""
