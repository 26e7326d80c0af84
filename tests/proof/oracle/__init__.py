"""Random trajectories, judged by the gate and by an oracle that shares no rule with it: `make oracle`."""
