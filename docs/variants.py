"""Writes the tables of docs/variants.md: the same scans, mapped by every variant of a map.

The lab is simulated. The recorded buildings are mapped if OGM_DATASETS names the folder that they are in;
their tables stay as they are if not.
"""

import json
import os
import re
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from ogm_core.files.map_files import read_npz
from ogm_core.lattice import CellRect, Lattice
from ogm_core.quality.truth import occupied_cells
from ogm_core.simulation.worlds import lab

PAGE = Path(__file__).with_name("variants.md")
VARIANTS = {
    "`beam`, `bresenham`": ["--sensor-model", "beam", "--traversal", "bresenham"],
    "`beam`, `dda`": ["--sensor-model", "beam", "--traversal", "dda"],
    "`sector`": ["--sensor-model", "sector"],
    "`rate`": ["--cell-model", "rate"],
}
MODELS = dict(zip(VARIANTS, ("bresenham", "dda", "sector", "rate"), strict=True))
"""What `ogm quality` calls them."""
BUILDINGS = {
    "intel": "intel/intel-corrected.log.gz",
    "freiburg-079": "freiburg-079/freiburg-079-corrected.log.gz",
}
RECORDED = ["--range-max", "79", "--reach", "25", "--clear-range", "25"]
DENSE = {"freiburg-079": ["--every", "5"]}
"""In which each scan has a twin, one in so many counts."""
FIGURES = {"bits": 2, "hit": 3, "unknown": 3, "short": 3, "long": 3, "false_free": 3}
"""What is printed of `ogm quality`'s figures, with how many decimals."""


def main() -> None:
    """Map everything, and write the tables between their marks."""
    page = PAGE.read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder:
        page = with_table(page, "lab", lab_table(Path(folder)))
        datasets = os.environ.get("OGM_DATASETS")
        for name, log in BUILDINGS.items() if datasets else ():
            page = with_table(page, name, building_table(Path(datasets or "", log), DENSE.get(name, [])))
    PAGE.write_text(page, encoding="utf-8")


def with_table(page: str, name: str, table: str) -> str:
    """The page with this table between the marks of that name."""
    begin, end = f"<!-- table {name} -->\n", "<!-- end of table -->"
    return re.sub(f"{begin}.*?{end}", lambda _: f"{begin}{table}{end}", page, count=1, flags=re.DOTALL)


def lab_table(folder: Path) -> str:
    """One lap through the lab by preset `lab`, against the true world."""
    log = folder / "lab.jsonl.gz"
    ogm("simulate", "--world", "lab", "--scans", "220", "--seed", "1", "--out", log)
    rows = [["variant", "accuracy", "IoU", "precision", "recall", "log loss", "entropy", "p on the rims"]]
    for name, flags in VARIANTS.items():
        out = folder / "lab"
        ogm("build", log, "--out", out, "--preset", "lab", "--world", "lab", *flags)
        quality = json.loads((out / "quality.json").read_text())
        truth = [quality["truth"][key] for key in ("accuracy", "iou", "precision", "recall", "log_loss")]
        figures = [*truth, quality["mean_entropy_bits"], rim_probability(out / "map.npz")]
        rows.append([name, *(f"{figure:.3f}" for figure in figures)])
    return markdown(rows)


def rim_probability(npz: Path) -> float:
    """Mean probability "occupied" of the known cells that the outlines of the lab's circles meet."""
    found = read_npz(npz.read_bytes())
    world = lab()
    circles = replace(world, segments=world.segments[:0])
    height, width = found.log_odds.shape
    rect = CellRect(*found.offset, width, height)
    rims = found.log_odds[occupied_cells(circles, Lattice(found.resolution, found.anchor), rect)]
    return float(np.mean(1.0 / (1.0 + np.exp(-rims[~np.isnan(rims)]))))


def building_table(log: Path, flags: list[str]) -> str:
    """A recorded building, judged by scans that are held out."""
    said = json.loads(ogm("quality", log, *RECORDED, *flags, "--models", ",".join(MODELS.values()), "--json"))
    rows = [["variant", *(name.replace("_", " ") for name in FIGURES)]]
    for name, model in MODELS.items():
        figures = said[model][str(log)]
        rows.append([name, *(f"{figures[figure]:.{decimals}f}" for figure, decimals in FIGURES.items())])
    return markdown(rows)


def markdown(rows: list[list[str]]) -> str:
    """A table; its first row is the head."""
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    lines.insert(1, "|---" * len(rows[0]) + "|")
    return "\n".join(lines) + "\n"


def ogm(*arguments: object) -> str:
    """Run the program as a user would; what it prints."""
    command = [sys.executable, "-m", "ogm_services", *map(str, arguments)]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


if __name__ == "__main__":
    main()
