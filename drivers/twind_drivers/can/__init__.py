"""CAN actuators: codecs of their families, channels to the wire, and the bus that the loop drives."""
