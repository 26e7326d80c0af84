"""The steps of `twindctl calibrate`, each a file with `add_arguments` and `run`, and the pure rooms they share."""
