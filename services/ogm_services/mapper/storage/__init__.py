"""A map on disk: written while it is mapped, restored at the start, saved under names, repaired."""
