"""Tracking rigid objects with one camera: world → arm → spatial (example 3 of the paper)."""
