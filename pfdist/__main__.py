"""``python -m pfdist`` is ``pfdist``."""

import sys

from pfdist.cli.main import main

sys.exit(main())
