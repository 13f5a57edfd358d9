"""Questions about finished cells: rays through them, footprints on them, distances between them."""
