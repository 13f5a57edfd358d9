"""The processes: mapper, simulator, replayer, and `ogm`, the program that starts them.

Importing the package loads nothing; every command of `ogm` imports what it needs when it runs.
"""
