"""From a relative pose to a map: views, triangulation, candidates, rivals."""
