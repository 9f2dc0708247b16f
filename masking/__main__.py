"""`python -m masking`: the command line."""

import sys

from masking.cli import main

sys.exit(main())
