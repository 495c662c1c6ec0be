"""Exit pupil of a scene and the wave in it: aimed rays, wall aberration, facets."""
