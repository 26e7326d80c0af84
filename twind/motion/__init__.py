"""How a goal moves in time: executor, stops, settling. Pure."""
