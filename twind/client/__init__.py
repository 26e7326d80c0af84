"""Python client of the control socket. Standard library only."""
