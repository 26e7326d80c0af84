"""Front process: varlink server, telemetry fan-out, logs. Runs beside the loop, never in it."""
