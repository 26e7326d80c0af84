"""The control interface: IDL text and plain types. Standard library only."""
