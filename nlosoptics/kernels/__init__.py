"""Compiled functions shared by several packages: wall heights, material lobes, random numbers."""
