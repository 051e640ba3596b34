"""From poses to a map: views, triangulation, the map of known poses."""
