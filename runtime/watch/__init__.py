"""What can be seen of a node while it runs: its times, its state, its messages, its log."""
