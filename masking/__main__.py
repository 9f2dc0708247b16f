"""`python -m masking`: the command line."""

import sys

from masking.app.cli import main

if __name__ == "__main__":
    sys.exit(main())
