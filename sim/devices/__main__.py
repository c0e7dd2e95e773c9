"""`python -m sim.devices`: run virtual devices; see `sim.devices.hub`."""

import sys

from sim.devices.hub import main

sys.exit(main())
