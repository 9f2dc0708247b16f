"""`python -m masking.cli`."""

import sys

from masking.cli.parser import main

sys.exit(main())
