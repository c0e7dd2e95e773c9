"""One search behind one port: the settings of a camera that are best for a request."""
