"""Import of a robot's MJCF, URDF or xacro file as a model that twind can use."""
