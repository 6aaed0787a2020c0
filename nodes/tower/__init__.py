"""An arm that builds towers: world → arm → spatial → skills → builder. The last one reasons with symbols."""
