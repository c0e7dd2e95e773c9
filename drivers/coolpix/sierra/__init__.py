"""The Sierra serial protocol of still cameras, from the host side."""
