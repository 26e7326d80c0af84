"""Process of the loop: real-time set-up, service manager, signals, child processes."""
