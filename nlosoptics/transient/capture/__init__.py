"""Time-resolved captures: their data class, file formats, preprocessing and detectors."""
