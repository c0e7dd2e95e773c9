"""Front panels: what a person sees and presses."""
