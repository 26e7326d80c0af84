"""Driver of CAN actuators: codecs of their families, channels to the wire, and the bus of the loop."""
