"""Worlds, robots that drive through them, and what their LiDARs see."""
