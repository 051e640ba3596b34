"""Decision rules: two views, planar ambiguity, map, rotation-only camera."""
