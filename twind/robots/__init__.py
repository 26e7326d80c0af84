"""The built-in robots: our own 24-joint humanoid `h24`."""
