"""Searches, which choose the next points of a study by the figures of earlier ones."""
