"""The tests in guest/ need the devices of a guest; the programs here are no tests."""

import os

collect_ignore = ["guest_modules.py", "machine.py", "run.py"]
if not os.environ.get("CAMCTL_IN_GUEST"):
    collect_ignore += ["guest"]
