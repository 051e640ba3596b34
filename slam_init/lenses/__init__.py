"""The lenses of cameras: their models, and the one projection with derivatives, compiled."""
