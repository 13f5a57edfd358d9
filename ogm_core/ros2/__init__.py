"""ROS 2 in bytes and values: messages, transforms, and what a mapper needs of them; it opens nothing."""
