"""The interface that every camera implements: all that a driver's author reads."""
