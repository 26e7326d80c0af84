"""Manual pages, shell completion and the reference page of the commands, all made from their parsers."""
