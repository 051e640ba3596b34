"""From poses to a map: views, triangulation, the map of known poses."""

from quest.moved import moved_names

# Names that the module of this name had; dropped in version 0.3.
__getattr__ = moved_names(
    __name__,
    {
        "Margin": "slam_init.types.comparison",
        "TrackTable": "slam_init.mapping.views",
        "table_of": "slam_init.mapping.views",
        "voting_views": "slam_init.mapping.views",
    },
)
