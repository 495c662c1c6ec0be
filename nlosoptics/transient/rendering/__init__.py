"""Rendering of captures from meshes or scenes."""
