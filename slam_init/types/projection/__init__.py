"""The compiled projection of points by all models of cameras, with its derivatives: the only one with derivatives."""
