"""Benchmarks: hierax beside a rival, in the same run and on the same work."""
