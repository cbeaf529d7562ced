"""`python -m planspace` is `planspace`."""

import sys

from planspace.cli import main

sys.exit(main())
