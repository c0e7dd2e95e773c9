"""Virtual hardware that shows a simulated sensor before a scene: webcam, still cameras."""
