"""Python imports this at its start in each process whose PYTHONPATH begins with this folder."""

from tests.support import blanking

blanking.hook()
