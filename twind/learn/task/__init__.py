"""Definition of what is learned, alike in simulation and on a robot: task, observation, action, reward."""
