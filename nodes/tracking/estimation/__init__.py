"""From an image and what was expected to poses: profiles across edges, alignment, fusion with the prediction."""
