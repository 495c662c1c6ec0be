"""Captures rendered from meshes or scenes."""
