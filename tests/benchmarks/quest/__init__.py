"""Measurements of the solvers and of the robust estimate; the commands print tables in markdown."""
