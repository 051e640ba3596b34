"""What a run writes: results, COLMAP model, terminal report."""
