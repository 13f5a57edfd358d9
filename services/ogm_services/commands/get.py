"""`ogm get`: what a running mapper serves, as files."""

from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO
from urllib.parse import parse_qsl

from ogm_client import MapClient
from ogm_client.transport import NAMES
from ogm_core.errors import BadInput, BadParameter, cut
from ogm_core.files.file_names import check_suffix, check_text, ros_map_names
from ogm_core.lattice import Region
from ogm_core.whole_files import write_files
from ogm_core.wire.addresses import masked
from ogm_services.commands.mapper_client import asking
from ogm_services.results.written import written
from ogm_services.settings.values import parse_region

STDOUT = Path("-")


def check_asked(name: str, at: str | None = None) -> None:
    """Refuse what no mapper serves, whether or not one is there.

    Raises:
        BadInput: `name`, which may carry parameters, is none of NAMES, or nothing that is saved as `at`.
    """
    check_text(name, "NAME")
    if "://" in name:
        raise BadInput(f"{masked(name)!r}: NAME says what to fetch, such as map.png; --url where from")
    bare = name.lstrip("/").partition("?")[0]
    if bare not in NAMES:
        raise BadInput(f"{cut(bare)!r} cannot be fetched, only {', '.join(NAMES)}")
    if at is not None and not bare.startswith("map."):
        raise BadInput(f"--at {cut(at)}: only maps are saved, and {bare} is none")


def fetch(
    client: MapClient, name: str, out: Path | None, stdout: BinaryIO, at: str | None = None
) -> tuple[Path, ...]:
    """Write what the mapper serves as `name` into `out`, or to `stdout` if that is "-"; the files written.

    `name` may carry parameters: map.png?palette=probability&max_size=500. map.yaml comes with its PGM,
    beside it and of the same map. `at`: the map that is saved under this name. Without `out` the file is
    called what it is, in the working folder.

    Raises:
        BadInput: a parameter is wrong, or `out` cannot be written, or its name is that of another format.
        DiskFull: there is no room for it.
        ClientError: the mapper does not answer, or refuses.
    """
    check_text(name, "NAME")
    name, _, query = name.lstrip("/").partition("?")
    parameters = _parameters(query)
    if at is not None and parameters.setdefault("at", at) != at:
        raise BadParameter(f"--at says {cut(at)}, and NAME at={cut(parameters['at'])}: give one of the two")
    own = name if "." in name else f"{name}.json"
    if out is None:
        out = Path(own)
    elif out != STDOUT and name != "map.yaml":
        check_suffix(out, Path(own).suffix)
    if name == "map.yaml":
        return _fetch_ros_map(client, parameters, out)
    with asking():
        content = client.fetch(name, **parameters)
    with written(out, "-o"):
        if out == STDOUT:
            stdout.write(content)
            stdout.flush()
            return ()
        write_files({out: content})
    return (out,)


def _fetch_ros_map(client: MapClient, parameters: Mapping[str, str], out: Path) -> tuple[Path, ...]:
    region, partial = _region(parameters), _partial(parameters)
    if out == STDOUT:
        raise BadInput("map.yaml comes with its map.pgm, two files: give -o FILE.yaml")
    names = ros_map_names(out)
    with asking():
        grid = client.get_map(region, at=parameters.get("at"), partial=partial)
    with written(out, "-o"):
        grid.save_ros_map(out)
    return names


def _parameters(query: str) -> dict[str, str]:
    try:
        given = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError:
        raise BadParameter(f"{query!r}: parameters are written KEY=VALUE&KEY=VALUE") from None
    pairs = [(key, value) for key, value in given if key != "t"]  # which a mapper does not hear, either
    parameters = dict(pairs)
    if len(parameters) < len(pairs):
        raise BadParameter(f"{query!r}: every parameter is given once")
    return parameters


def _region(parameters: Mapping[str, str]) -> Region | None:
    unknown = sorted(parameters.keys() - {"region", "at", "complete"})
    if unknown:
        raise BadParameter(
            f"map.yaml takes the parameters region, at and complete only, not {', '.join(unknown)}"
        )
    if "region" not in parameters:
        return None
    try:
        return parse_region(parameters["region"])
    except ValueError as error:
        raise BadParameter(f"region: {error}") from None


def _partial(parameters: Mapping[str, str]) -> bool:
    """Whether a map of which shares are missing will do, too."""
    complete = parameters.get("complete", "1")
    if complete not in {"0", "1"}:
        raise BadParameter(f"complete: 0 or 1 is needed, got {cut(complete)!r}")
    return complete == "0"
