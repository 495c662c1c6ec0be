"""Pupil outlines, and the quadrature nodes and grids inside them."""
