"""A map that is cut into shares, each with a mapper of its own: how they are asked, and put together."""
