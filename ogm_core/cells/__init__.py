"""What one cell stores, how an observation changes it, and what it means."""
