"""Scene files: TOML in which lengths, times, rates, powers and angles carry their units."""

from .scene_file import read_scene, save_scene
from .schema import scene_schema
from .text import scene_files

__all__ = ["read_scene", "save_scene", "scene_files", "scene_schema"]
