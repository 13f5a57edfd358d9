"""Where a map's cells lie in memory, which of them were written, and copies of them."""
