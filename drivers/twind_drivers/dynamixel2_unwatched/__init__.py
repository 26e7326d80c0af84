"""Serial servos of Protocol 2.0 without a bus watchdog: XL-320 and PRO -R. Tables, virtual twin."""
