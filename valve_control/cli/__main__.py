"""``python -m valve_control.cli``."""

import sys

from valve_control.cli import main

sys.exit(main())
