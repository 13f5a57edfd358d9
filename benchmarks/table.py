"""Measured values with their targets: shown as a table, kept as JSON and Markdown."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

HEADER = ("what", "measured", "target", "met")


@dataclass(frozen=True)
class Result:
    """One measured `value` of what `name` says, in `unit`; results of a `group` are shown together.

    With a `target` it is met by a value of at least as much, or of at most as much if not `at_least`.
    """

    group: str
    name: str
    value: float
    unit: str
    target: float | None = None
    at_least: bool = True

    @property
    def met(self) -> bool | None:
        """Whether the target is met; None where there is none."""
        if self.target is None:
            return None
        return self.value >= self.target if self.at_least else self.value <= self.target

    @property
    def cells(self) -> tuple[str, str, str, str]:
        """What the table shows: see HEADER."""
        target = ""
        if self.target is not None:
            target = f"{'at least' if self.at_least else 'at most'} {with_unit(self.target, self.unit)}"
        met = {None: "", True: "yes", False: "**no**"}[self.met]
        return self.name, with_unit(self.value, self.unit), target, met


def with_unit(value: float, unit: str) -> str:
    """Three significant digits and the unit; whole numbers and those from 1000 on without decimals."""
    whole = isinstance(value, int) or abs(value) >= 999.5
    digits = f"{value:,.0f}" if whole else f"{value:#.3g}".rstrip(".")
    return f"{digits} {unit}".rstrip()


def groups_of(results: Iterable[Result]) -> dict[str, list[Result]]:
    """Results by group, in the order in which they came."""
    groups: dict[str, list[Result]] = {}
    for result in results:
        groups.setdefault(result.group, []).append(result)
    return groups


def as_text(results: Iterable[Result]) -> str:
    """A table for a terminal."""
    lines: list[str] = []
    for group, members in groups_of(results).items():
        rows = [tuple(cell.strip("*") for cell in row) for row in (HEADER, *(m.cells for m in members))]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines += ["", group]
        for row in rows:
            lines.append("  " + "  ".join(map(str.ljust, row, widths)).rstrip())
    return "\n".join(lines) + "\n"


def as_markdown(results: Iterable[Result], heading: str) -> str:
    """A page with one table a group."""
    lines = [f"# {heading}"]
    for group, members in groups_of(results).items():
        lines += ["", f"## {group}", "", _row(HEADER), "|---|---|---|---|"]
        lines += [_row(member.cells) for member in members]
    return "\n".join(lines) + "\n"


def targets(results: Iterable[Result]) -> str:
    """One Markdown table of the results that have a target, each group below a row with its name."""
    lines = [_row(HEADER), "|---|---|---|---|"]
    for group, members in groups_of(result for result in results if result.target is not None).items():
        lines.append(_row((f"**{group}**", "", "", "")))
        lines += [_row(member.cells) for member in members]
    return "\n".join(lines) + "\n"


def as_json(results: Iterable[Result]) -> str:
    """A list of the results with their fields and `met`."""
    return json.dumps([asdict(result) | {"met": result.met} for result in results], indent=1) + "\n"


def keep(results: Sequence[Result], folder: Path, heading: str) -> None:
    """Write `results.json` and `results.md` into a folder, which is made if need be."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "results.json").write_text(as_json(results), encoding="utf-8")
    (folder / "results.md").write_text(as_markdown(results, heading), encoding="utf-8")


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
