"""Commands and benchmarks of the nodes, for `hierax`; it finds them by their entry points (pyproject.toml)."""
