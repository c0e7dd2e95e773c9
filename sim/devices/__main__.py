"""`python -m sim.devices`: see `sim.devices.hub`."""

import sys

from sim.devices.hub import main

sys.exit(main())
