"""The matrix of 40 faults: each injected again and again, under the fake clock and in real time.

`python -m tests.proof.faults.run` (or `make faults`) runs them and prints how soon each was told.
"""
