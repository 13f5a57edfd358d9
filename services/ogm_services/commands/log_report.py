"""Report on a log that was mapped: what became of its scans, and what should be known of it."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from ogm_services.commands.log_feed import LogFeed
from ogm_services.commands.log_readers import LogReader


@dataclass
class LogReport:
    """What became of a log's scans."""

    log: Path
    scans: int
    """How many were read."""
    integrated: int
    held: int
    dropped: dict[str, int]
    """How many came into no map, by the reason, in a fixed order; also reasons of none."""
    beams_on_robots: int
    odd_poses: dict[str, int]
    malformed: int
    malformed_in_words: str
    not_read: str
    complaints: list[str] = field(default_factory=list)
    """What is wrong with the log's messages, in lines."""
    doubts: list[str] = field(default_factory=list)
    """Settings that are for nobody in the log, and how it was read."""

    @classmethod
    def of(cls, log: Path, messages: LogReader, feed: LogFeed, integrated: int, held: int) -> Self:
        """That of a pass over a log which is done; the map has `integrated` scans of it, `held` stay out."""
        counts = feed.receipts.status()
        doubts = [f"sensors: {glob}: no sensor of this log is called so" for glob in feed.sensors.unmatched]
        doubts += [f"robots: {glob}: no robot of this log is called so" for glob in feed.robots.unmatched]
        if messages.doubt:
            doubts.append(f"{log}: {messages.doubt}")
        return cls(
            *(log, messages.scans, integrated, held, dict(counts.scans.dropped)),
            counts.scans.beams_on_robots,
            counts.poses.odd,
            messages.malformed,
            f"{messages.malformed} malformed {messages.unit} ({'; '.join(messages.complaints)})",
            messages.not_read,
            feed.complaints.lines(),
            doubts,
        )

    @property
    def text(self) -> str:
        """How many scans were read, integrated, held out, dropped and why, in one line."""
        parts = [f"{self.scans} scans read", f"{self.integrated} integrated"]
        if self.held:
            parts.append(f"{self.held} held out")
        parts += [f"{count} dropped: {reason}" for reason, count in self.dropped.items() if count]
        if self.beams_on_robots:
            parts.append(f"{self.beams_on_robots} beams skipped that ended at other robots")
        parts += [f"{count} poses {what}" for what, count in self.odd_poses.items()]
        if self.malformed:
            parts.append(self.malformed_in_words)
        if self.not_read:
            parts.append(f"not read: {self.not_read}")
        return ", ".join(parts)

    @property
    def figures(self) -> dict[str, Any]:
        """The same as numbers."""
        return {
            "scans": self.scans,
            "integrated": self.integrated,
            "held_out": self.held,
            "dropped": {reason: count for reason, count in self.dropped.items() if count},
            "beams_on_robots": self.beams_on_robots,
            "odd_poses": self.odd_poses,
            "malformed": self.malformed,
            "not_read": self.not_read,
        }
