"""A node at work: its runner, its membership of a run that changes, the world's, and all of them in one process."""
