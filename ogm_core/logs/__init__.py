"""Recorded logs: what they hold, and readers of their formats."""
