"""The built-in robots: robot files and their models. `servos.xml` describes the servos that models share."""
