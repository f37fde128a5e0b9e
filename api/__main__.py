"""`python -m api` is `kerntemp`."""

import sys

from api.cli import main

sys.exit(main())
