"""Where rays meet walls and triangle meshes, in float64."""
