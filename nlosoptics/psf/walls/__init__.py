"""From a whole scene to its point spread function."""
