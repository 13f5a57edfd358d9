"""`ogm merge`: saved maps of counts, added up to the map of all of their scans.

It imports what it needs when it runs, so that `ogm --help` answers at once.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from ogm_core.errors import BadInput, LimitReached
from ogm_core.whole_files import check_file, write_files
from ogm_services.results.written import out_path, written
from ogm_services.runtime.endings import INTERRUPTED
from ogm_services.runtime.kernel_cache import kernel_cache
from ogm_services.runtime.loading import loading
from ogm_services.runtime.log_lines import log_nothing
from ogm_services.runtime.signals import running_service

_OUT = "--out"


def merge(
    maps: Annotated[
        list[Path],
        typer.Argument(metavar="MAP.npz...", help="Two or more, of cell model rate and of one lattice."),
    ],
    out: Annotated[
        Path, typer.Option(_OUT, "-o", parser=out_path, metavar="FILE.npz", help="Write their sum here.")
    ],
) -> None:
    """Merge saved maps of counts into the map of all of their scans, count for count."""
    _check(maps, out)
    with log_nothing(), running_service(interrupted=INTERRUPTED), kernel_cache():
        with loading():
            from ogm_core.files.map_files import encode_npz
            from ogm_core.files.merged_maps import merge_maps
        try:
            merged = merge_maps(maps).finest()
            content = encode_npz(merged)
        except MemoryError as error:
            raise LimitReached("the system has no memory left for the merged map", "memory") from error
        with written(out, _OUT):
            write_files({out: content})
    size = f"{merged.width} x {merged.height} cells of {merged.resolution:g} m"
    typer.echo(f"{out}: {len(maps)} maps, {size}")


def _check(maps: Sequence[Path], out: Path) -> None:
    """Refuse what could only be found out at the end, and maps whose scans would count twice."""
    if len(maps) < 2:
        raise BadInput("two maps at least are needed to merge")
    if out.suffix.lower() != ".npz":
        raise BadInput(f"{_OUT} {out}: a name that ends in .npz is needed")
    files = [path.resolve() for path in maps]
    for n, path in enumerate(maps):
        if files[n] in files[:n]:
            raise BadInput(f"{path} is given twice: its scans would count twice")
    with written(out, _OUT):
        check_file(out)
