"""From a scene to its wave: exit pupil, aimed rays, wall wavefront, facets."""
