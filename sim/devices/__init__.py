"""Virtual hardware: a webcam and still cameras, each with a simulated sensor that sees a scene."""
