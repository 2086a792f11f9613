"""`python -m topokit` is the `topokit` command."""

import sys

from .cli import main

sys.exit(main())
