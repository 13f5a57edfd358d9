"""What robots and mappers send each other: keys and messages."""
