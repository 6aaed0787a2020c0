"""Conformance kits: what hierax tests its own parts with, for parts that others write."""
