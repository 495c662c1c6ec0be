"""Import and export of waves: POPPY files, prysm objects, Zernike tables."""
