"""The rerun recording: everything that the pipeline saw and decided."""
