"""Recordings as data sets that others train on: LeRobotDataset v3.0. Reads files alone, off the robot."""
