"""Outlines of pupils, and the quadrature nodes inside them."""
