"""Which exposures to combine: mathematics on responses, independent of any camera."""
