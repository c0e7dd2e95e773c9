"""The most accurate sets of exposures for each time, by estimate and by exact prediction."""
