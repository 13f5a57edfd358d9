"""How a process starts, says how it is getting on, and ends."""
