"""Compiled functions that several packages call: wall heights, lobes, random draws."""
