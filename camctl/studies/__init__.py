"""Studies: accuracy, time and the solver compared with other methods, as rows, tables and plots.

Each module measures one thing and returns rows; `camctl.cli.tradeoff` prints them.
"""
