"""Answers, where they are given, and how errors become replies."""
