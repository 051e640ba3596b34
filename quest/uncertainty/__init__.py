"""Whether the translation is observable, and the ratio of its length to the depths."""
