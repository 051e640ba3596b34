"""The recording of a run for the Rerun viewer: frames, tracks, attempts, maps."""

from quest.moved import moved_names

# Names that the module of this name had; dropped in version 0.3.
__getattr__ = moved_names(
    __name__,
    {
        "Recorder": "slam_init.recording.recorder",
        "RerunRecorder": "slam_init.recording.rerun_recorder",
    },
)
