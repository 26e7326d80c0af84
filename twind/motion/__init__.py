"""Motion in time: trajectories, setpoints, stops, settling, end-stop search. Pure."""
