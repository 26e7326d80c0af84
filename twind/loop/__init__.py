"""The loop process: tick, procedures, hardware, link, real-time set-up."""
