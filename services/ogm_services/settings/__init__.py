"""What may be set, within which limits, by which flags, and which source wins."""
