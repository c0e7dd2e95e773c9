"""Real cameras, each behind the interface of `camctl.interface.camera`."""
