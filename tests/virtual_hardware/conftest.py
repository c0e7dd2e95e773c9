"""The tests in guest/ need the guest's devices: on the host they are not collected."""

import os

collect_ignore = [] if os.environ.get("CAMCTL_IN_GUEST") else ["guest"]
