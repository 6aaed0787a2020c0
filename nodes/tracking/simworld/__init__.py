"""The simulated world: cubes on a table, drawn exactly, with light and shadows."""
