"""Table of maps that were judged by held-out beams: a line for every log and model, and means over logs."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ogm_core.quality.judgement import Judgement

HEAD = (
    *("log", "model", "bits", "95 %", "hit", "unknown", "short", "long", "false free"),
    *("free m2", "occupied m2", "known m2"),
)
_NAMES = 2
"""So many columns are text, to the left."""


def quality_table(judged: Mapping[str, Mapping[str, Judgement]]) -> list[str]:
    """Lines of the table, of judgements by model and log; models of one log stand below each other."""
    logs = list(next(iter(judged.values())))
    names = {Path(log).name for log in logs}
    shown = {log: Path(log).name if len(names) == len(logs) else log for log in logs}
    rows = [[shown[log], model, *_cells(by_log[log])] for log in logs for model, by_log in judged.items()]
    if len(logs) > 1:
        rows += [
            [f"mean of {len(logs)} logs", model, *_means(list(by_log.values()))]
            for model, by_log in judged.items()
        ]
    widths = [max(map(len, column)) for column in zip(HEAD, *rows, strict=True)]
    return [_line(row, widths) for row in (HEAD, *rows)]


def _line(row: Sequence[str], widths: Sequence[int]) -> str:
    cells = [
        text.ljust(width) if k < _NAMES else text.rjust(width)
        for k, (text, width) in enumerate(zip(row, widths, strict=True))
    ]
    return "  ".join(cells).rstrip()


def _cells(judgement: Judgement) -> list[str]:
    interval = judgement.interval
    between = "-" if interval is None else f"{interval[0]:.2f} to {interval[1]:.2f}"
    bits, *others = _formatted(_numbers(judgement))
    return [bits, between, *others]


def _means(judgements: Sequence[Judgement]) -> list[str]:
    """Means over logs; of one that lacks a figure there is none."""
    columns = zip(*map(_numbers, judgements), strict=True)
    bits, *others = _formatted([None if None in column else float(np.mean(column)) for column in columns])
    return [bits, "", *others]


def _numbers(judgement: Judgement) -> list[float | None]:
    areas = judgement.free_m2, judgement.occupied_m2, judgement.known_m2
    return [judgement.bits, *judgement.walls, *areas]


def _formatted(numbers: Sequence[float | None]) -> list[str]:
    digits = (2, *(3,) * 5, *(1,) * 3)
    return [
        "-" if number is None else f"{number:.{count}f}"
        for number, count in zip(numbers, digits, strict=True)
    ]
