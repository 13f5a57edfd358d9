"""ROS 2's robots as they are: where their topics come from, and what is made of them for a mapper."""
