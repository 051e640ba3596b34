"""From a relative pose to a map: views, triangulation, candidates, rivals."""

from quest.moved import moved_names

# Names that the module of this name had; dropped in version 0.3.
__getattr__ = moved_names(
    __name__,
    {
        "MapCandidate": "slam_init.mapping.candidate",
        "Margin": "slam_init.types.comparison",
        "TrackTable": "slam_init.mapping.views",
        "build_candidate": "slam_init.mapping.candidate",
        "difference_of_maps_deg": "slam_init.mapping.rivals",
        "explained_at_most": "slam_init.mapping.rivals",
        "further_views": "slam_init.mapping.views",
        "margin": "slam_init.mapping.rivals",
        "margin_of": "slam_init.mapping.rivals",
        "rank": "slam_init.mapping.rivals",
        "same_map": "slam_init.mapping.rivals",
        "table_of": "slam_init.mapping.views",
        "voting_views": "slam_init.mapping.views",
    },
)
