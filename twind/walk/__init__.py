"""Walking without learning: footsteps, a pattern of the centre of mass, leg kinematics and balance by the IMU.

`WalkingEngine` gives goals of all joints for a velocity; whoever has goals sends them through the gate as any client.
"""
