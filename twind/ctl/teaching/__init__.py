"""`twindctl teach`: a motion from the path of a hand that guides limp joints."""
