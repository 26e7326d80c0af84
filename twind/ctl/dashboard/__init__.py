"""The live picture of a robot: its state, its blocks and layout, and the terminal."""
