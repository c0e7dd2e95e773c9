"""camctl: a camera controller that knows which exposures to combine."""

__version__ = "0.1.0"
