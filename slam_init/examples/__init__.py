"""Example programs: how to feed the initializer, use its map, and add data sets and methods."""
