"""Values of the robot file that a recording gives. Reads files alone."""
