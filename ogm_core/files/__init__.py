"""Maps as files: written for people, ROS and NumPy, and read from ROS."""
