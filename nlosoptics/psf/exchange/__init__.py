"""Waves for other programs and from them."""
