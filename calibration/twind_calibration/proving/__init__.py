"""What gravity proves of a joint's sign, place and zero, and what it cannot. A client."""
