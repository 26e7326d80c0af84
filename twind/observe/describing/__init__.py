"""The robot as other software wants it: its frames, and a URDF."""
