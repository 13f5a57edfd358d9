"""What a finished map is written as."""
