"""The audit of maps from anywhere: whether the tracks agree with their poses."""
