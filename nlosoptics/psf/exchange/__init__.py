"""Import and export of waves: prysm pupils, Zernike tables."""
