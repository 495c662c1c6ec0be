"""Fans of rays and random facets between wall and lens, and the paths that come of them."""
