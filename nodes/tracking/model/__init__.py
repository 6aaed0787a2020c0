"""What an object is: its mesh, its file, and what of it can be seen as an edge."""
