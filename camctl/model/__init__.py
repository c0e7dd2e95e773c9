"""The camera as a model: response, noise, effective camera and its inverse."""
