"""The steps of `twindctl calibrate`: a file each with `add_arguments` and `run`; pure rooms they share."""
