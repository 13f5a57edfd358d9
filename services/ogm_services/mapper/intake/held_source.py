"""Source of a robot that may be held: what is known of its messages, and of the caches that keep them."""

from dataclasses import dataclass, field

from ogm_services.mapper.intake.numbering import Numbering

SILENCE = 5.0
"""A source that has a cache and is silent for so long is asked, s; then after twice the time, and so on."""
MOST_SILENCE = 60.0


@dataclass(slots=True, eq=False)
class HeldSource:
    """A robot's poses, or one of its sensors."""

    numbering: Numbering
    heard: float
    """When it was heard last, s."""
    caches: set[str] = field(default_factory=set)
    """Those whose tokens are there."""
    had_cache: bool = False
    asked: float = 0.0
    """When it was asked because it was silent, s."""
    patience: float = SILENCE
    """How long it may then be silent until it is asked again, s."""
    none_of: str | None = None
    """A run of which no cache keeps anything: what is missing of it is lost at once."""

    def too_silent(self, now: float) -> bool:
        """Whether it is silent for too long for one that has a cache; it counts as asked then."""
        patience = SILENCE if self.heard > self.asked else self.patience
        if not self.caches or now - max(self.heard, self.asked) <= patience:
            return False
        self.asked, self.patience = now, min(2.0 * patience, MOST_SILENCE)
        return True
