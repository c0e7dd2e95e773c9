"""A USB device model, and the transports that connect it to a host."""
