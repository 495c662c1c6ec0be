"""Image window and pixels of a point spread function, and bounds on its errors."""
