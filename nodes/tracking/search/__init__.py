"""Poses of objects that are not where they were expected: many starts, and which of them the image explains."""
