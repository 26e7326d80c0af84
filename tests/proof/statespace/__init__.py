"""All interleavings of commands, faults and deaths that the loop's own state machines meet, up to a depth."""
