"""``python -m vidphys`` is ``vidphys``."""

import sys

from vidphys.cli import main

sys.exit(main())
