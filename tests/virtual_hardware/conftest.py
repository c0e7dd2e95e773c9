"""The tests in guest/ need the devices of the virtual machine: not collected on the host."""

import os

# Pytest reads only the nearest `collect_ignore`; the programs here would be imported for doctests.
collect_ignore = ["machine.py", "run.py"]
if not os.environ.get("CAMCTL_IN_GUEST"):
    collect_ignore.append("guest")
