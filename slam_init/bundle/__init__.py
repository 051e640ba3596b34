"""Bundle adjustment of the initial map: problem, noise estimate, gtsam graph, focal length, and the whole recipe."""
