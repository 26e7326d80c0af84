"""YAML files into frozen, checked settings: settings, robot file, calibration file, bus budget."""
