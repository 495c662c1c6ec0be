"""Window and pixels of a point spread function, and bounds of its errors."""
