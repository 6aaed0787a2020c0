"""What the nodes are compared with, and by what."""
