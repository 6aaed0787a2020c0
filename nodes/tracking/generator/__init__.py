"""Generated scenes for tracking: what stands where, how it moves, and from where it is seen."""
