"""Results: what a finished map is written as."""
