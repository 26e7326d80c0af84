"""Entry of `python -m twind.virtual`."""

import sys

from twind.virtual.virtual_main import main

if __name__ == "__main__":
    sys.exit(main())
