"""Which pose belongs to which scan, in what order, and how often."""
