"""The lenses of cameras, and the compiled loop of one of them."""
