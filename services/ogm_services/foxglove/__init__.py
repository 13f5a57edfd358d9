"""Foxglove bridge: a client of a mapper that serves its map and its robots to Foxglove and Lichtblick."""
