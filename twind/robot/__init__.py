"""Data types of a robot: joints, limits, states, trajectories, splines, findings. Pure; numpy only."""
