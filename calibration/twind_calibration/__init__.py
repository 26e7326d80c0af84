"""What is done to a robot before it moves: clients of the daemon, and of the port while none runs."""
