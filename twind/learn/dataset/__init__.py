"""Recordings as episodes of frames on a fixed grid, for a data set of LeRobot. Reads files alone."""
