"""Methods of papers, for comparison."""
