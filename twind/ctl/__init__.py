"""`twindctl`: its entry point and the verbs of the control socket."""
