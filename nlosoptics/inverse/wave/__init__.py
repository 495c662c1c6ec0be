"""The point spread function as a differentiable function of a wave or of scene parameters."""
