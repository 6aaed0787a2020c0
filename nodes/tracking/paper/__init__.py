"""The arm's update as the paper prints it: line segments and solvePnP."""
