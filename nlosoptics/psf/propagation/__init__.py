"""Free-space propagation of sampled complex fields between parallel planes."""
