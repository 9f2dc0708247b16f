"""`python -m masking.cli`."""

import sys

from masking.cli import main

sys.exit(main())
