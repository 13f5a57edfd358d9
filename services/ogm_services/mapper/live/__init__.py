"""Live map: written while it is read, and watched."""
