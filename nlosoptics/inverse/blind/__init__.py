"""Object and wall wave together, from images alone."""
