"""Report on a log that was mapped: what became of its scans, and what should be known of it."""

from pathlib import Path

from ogm_services.commands.log_feed import LogFeed
from ogm_services.commands.log_readers import LogReader


def outcomes(messages: LogReader, feed: LogFeed, integrated: int, held: int) -> str:
    """How many scans were read, integrated, held out, dropped and why, in one line."""
    counts = feed.receipts.status()
    parts = [f"{messages.scans} scans read", f"{integrated} integrated"]
    if held:
        parts.append(f"{held} held out")
    parts += [f"{count} dropped: {reason}" for reason, count in counts.scans.dropped.items() if count]
    if counts.scans.beams_on_robots:
        parts.append(f"{counts.scans.beams_on_robots} beams skipped that ended at other robots")
    parts += [f"{count} poses {what}" for what, count in counts.poses.odd.items()]
    if messages.malformed:
        parts.append(f"{messages.malformed} malformed {messages.unit} ({'; '.join(messages.complaints)})")
    if messages.not_read:
        parts.append(f"not read: {messages.not_read}")
    return ", ".join(parts)


def doubts(log: Path, messages: LogReader, feed: LogFeed) -> list[str]:
    """What should be known besides complaints: settings that are for nobody, and how the log was read."""
    lines = [f"sensors: {glob}: no sensor of this log is called so" for glob in feed.sensors.unmatched]
    lines += [f"robots: {glob}: no robot of this log is called so" for glob in feed.robots.unmatched]
    if messages.doubt:
        lines.append(f"{log}: {messages.doubt}")
    return lines
