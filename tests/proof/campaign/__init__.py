"""The harnesses as one campaign: each run takes the next inputs and adds to the totals. `make proof`."""
