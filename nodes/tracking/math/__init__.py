"""Rigid poses, one by one and many at once, and the pinhole camera."""
