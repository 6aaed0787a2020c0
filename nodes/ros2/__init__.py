"""ROS 2 without ROS: bags as sources of pictures, and recordings as bags."""
