"""Intake: from a message's arrival to the worker that handles it."""
