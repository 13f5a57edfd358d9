"""Units that this project counts in, besides those of SI."""

MEBIBYTE = 1024**2
"""Bytes."""
