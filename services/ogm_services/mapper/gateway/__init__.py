"""The gateway: answers in one mapper's words for the mappers of all shares of a map."""
