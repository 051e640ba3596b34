"""Pictures of a run: ``overview.png`` (:mod:`slam_init.pictures.overview`)."""
