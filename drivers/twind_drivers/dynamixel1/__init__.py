"""Driver family of Dynamixel servos with Protocol 1.0: AX, RX, EX, and MX with firmware below 39."""
