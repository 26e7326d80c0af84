"""The built-in robots, a pair of robot file and model each; `servos.xml` holds the servos that models share."""
