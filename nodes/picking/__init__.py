"""An arm that picks up a cube which its own camera tracks: world → arm → spatial → grasp."""
