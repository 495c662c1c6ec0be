"""Laser, camera, hidden object, occluders and materials."""
