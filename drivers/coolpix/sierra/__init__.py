"""The Sierra serial protocol of still cameras, host side: `session`, `commands`, `packets`."""
