"""`twindctl teleop`: a keyboard or a gamepad that moves a robot while its keys are held."""
