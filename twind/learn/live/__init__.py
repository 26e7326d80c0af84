"""A running twind as learners and policies have it: its states, and setpoints through the gate."""
