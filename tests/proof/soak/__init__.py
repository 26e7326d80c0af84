"""A long life: the whole daemon under the fake clock for days, or as processes for minutes, with faults.

`make soak HOURS=1 [SEED=0] [ROBOT=koch] [JOBS=2]`, `make soak MINUTES=10 REAL=1`.
"""
