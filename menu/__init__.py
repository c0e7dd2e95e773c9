"""The camera menu: a state machine, its screens, and the panels that show it."""
