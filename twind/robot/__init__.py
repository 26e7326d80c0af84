"""The ground: joints, limits, states, trajectories, splines, findings. Pure; numpy only."""
