"""Time-resolved captures: the noun, its files, preprocessing and detectors."""
