"""What each command of `ogm` does."""
