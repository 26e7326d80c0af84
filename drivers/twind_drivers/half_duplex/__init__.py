"""Half-duplex serial line, shared by the families of serial servos."""
