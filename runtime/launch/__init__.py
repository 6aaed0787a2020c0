"""Running each node in a process of its own: the supervisor, and what its children do."""
