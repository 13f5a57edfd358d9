"""The map that is written while it is read, and what is watched of it."""
