"""What `make bench` measures: the map against other programs of its kind, and the services."""
