"""Pictures from shadows on a matt wall: fits with a known occluder, and with an unknown place."""
