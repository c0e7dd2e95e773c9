"""Which exposures to combine: pure mathematics that knows no camera."""
