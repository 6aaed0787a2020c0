"""What the spatial node imagines: bodies that move, and what the camera will see of them."""
