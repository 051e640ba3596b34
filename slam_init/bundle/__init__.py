"""Bundle adjustment: problem, noise, gtsam graph, focal length, recipe."""
