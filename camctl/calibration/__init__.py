"""Measuring properties that a camera does not report."""
