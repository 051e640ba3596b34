"""Programs to read: what to do with an initial map."""
