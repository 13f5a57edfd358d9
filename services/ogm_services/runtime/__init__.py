"""Life of a process: how it starts, says how it is getting on, and ends."""
