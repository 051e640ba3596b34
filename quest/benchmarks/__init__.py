"""Measurements of the solvers; each module is a command that prints a table."""
