"""Panels: one module each."""
