"""The recorder: what robots publish to a map, as a file."""
