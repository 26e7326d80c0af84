"""Every published figure beside its peers, in one run: `python -m bench [GROUP or start of a key]`."""
