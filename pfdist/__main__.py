"""``python -m pfdist`` is ``pfdist``."""

import sys

from pfdist.cli import main

sys.exit(main())
