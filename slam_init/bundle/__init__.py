"""Bundle adjustment of the initial map: problem, noise estimate, gtsam graph, focal length, and the whole recipe."""

from quest.moved import moved_names

# Names that the module of this name had; dropped in version 0.3.
__getattr__ = moved_names(
    __name__,
    {
        "adjust": "slam_init.bundle.adjustment",
    },
)
