"""A running twind as learners and policies have it: what is heard of it, and setpoints through the gate."""
