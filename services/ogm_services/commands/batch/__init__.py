"""Maps of logs by several processes: a task a log, then a task an area, then the parts are pasted."""
