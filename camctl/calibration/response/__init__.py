"""The response of a camera, from an exposure series of any scene or from a chart."""
