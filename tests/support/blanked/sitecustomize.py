"""Python imports this at its start in each process whose PYTHONPATH begins with this folder."""

import blanking

blanking.hook()
