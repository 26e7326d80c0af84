"""Doctor of CAN actuators: inspections of their buses."""
