"""Panels that can show the menu, one module each."""
