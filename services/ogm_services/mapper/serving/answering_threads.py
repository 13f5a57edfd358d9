"""Answering threads: what one kind of question takes, the others still have."""

from ogm_services.replies.turns import MAX_QUESTIONS, Turns

HTTP_QUESTIONS = 256
"""So many requests of a kind may wait for their turn."""
ZENOH_QUESTIONS = MAX_QUESTIONS
"""So many queries of a kind may."""


class AnsweringThreads:
    """Turns for every kind of question, of one protocol: each route says which it belongs to.

    They are few, because what is made at the same time takes memory at the same time. A mapper has two of
    them, one for HTTP and one for Zenoh: so 16 maps are made at once at most, 8 for each.
    """

    def __init__(self, waiting: int) -> None:
        """Of each kind `waiting` questions may wait for a thread."""
        self.maps = Turns("maps", 8, waiting)
        """Maps, cells and figures: what may take long."""
        self.status = Turns("status", 4, waiting)
        """What is asked to see whether all is well; it never waits for a map."""
        self.writes = Turns("writes", 2, waiting)
        """What waits for the worker."""

    def close(self) -> None:
        """Refuse who waits, and finish what is in hand."""
        for turns in (self.status, self.maps, self.writes):
            turns.close()
