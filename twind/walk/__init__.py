"""Walking without learning: footsteps, a pattern of the centre of mass, leg kinematics, balance by the IMU.

`WalkingEngine` gives goals of all joints for a velocity, to be sent through the gate by any client.
"""
