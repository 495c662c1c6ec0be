"""From a wave to its point spread function."""
