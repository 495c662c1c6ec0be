"""Images of traced light: pixels, path lengths, colours."""
