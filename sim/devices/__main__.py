"""`python -m camctl.sim.devices`: run virtual devices; see `camctl.sim.devices.hub`."""

import sys

from camctl.sim.devices.hub import main

sys.exit(main())
