"""Limits of a mapper: how much of everything may wait, and how much may be held, all in one place."""

from dataclasses import dataclass
from typing import Self

from ogm_core.units import MEBIBYTE
from ogm_services.mapper.intake.load import MAX_WORK
from ogm_services.mapper.intake.queue import MAX_BYTES
from ogm_services.mapper.intake.work import FIRST_RATE
from ogm_services.mapper.serving.answering_threads import HTTP_QUESTIONS, ZENOH_QUESTIONS
from ogm_services.replies.in_flight import MAX_IN_FLIGHT
from ogm_services.runtime.memory import MemoryUse
from ogm_services.settings.settings import MapperSettings

WAITING_BYTES = 256 * MEBIBYTE
"""What scans may hold that wait for poses, of all robots."""
ROBOTS_BYTES = 256 * MEBIBYTE
"""What robots' poses, and the seqs and runs of their scans, may hold: at 50,000 poses a second half of it."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What a mapper's parts are given of it; those of the map itself are in its `GridSettings`.

    Where a mapper has little memory in all, the bytes of each part are less than what it would like.
    """

    beams: int
    """Of one scan."""
    queue_scans: int
    queue_bytes: int
    """Payload of the messages that wait for the worker."""
    queue_work: float
    """The worker's time for them, s."""
    waiting_bytes: int
    """Of the scans that wait for their poses, of all robots together."""
    robots_bytes: int
    """Of all robots' poses, and the seqs and runs of their scans."""
    waiting_cells: float
    """Of one robot's scans that wait: one pose can make all of them ready at once."""
    answer_bytes: int
    """Of answers that are being made and sent."""
    http_questions: int
    """Requests of a kind that wait for their turn."""
    zenoh_questions: int
    """The same of queries."""

    @classmethod
    def of(cls, settings: MapperSettings, memory: MemoryUse) -> Self:
        """Limits by the settings, and by the memory that the parts share."""
        return cls(
            beams=settings.max_beams,
            queue_scans=settings.queue,
            queue_bytes=memory.share(MAX_BYTES),
            queue_work=MAX_WORK,
            waiting_bytes=memory.share(WAITING_BYTES),
            robots_bytes=memory.share(ROBOTS_BYTES),
            waiting_cells=MAX_WORK / FIRST_RATE,
            answer_bytes=memory.share(MAX_IN_FLIGHT),
            http_questions=HTTP_QUESTIONS,
            zenoh_questions=ZENOH_QUESTIONS,
        )
