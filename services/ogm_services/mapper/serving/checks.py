"""Checks of points and footprints: what a request asks about, in JSON, and what a map says to it."""

from collections.abc import Sequence
from typing import Any

import orjson

from ogm_core.cells.classes import trinary
from ogm_core.errors import BadParameter, cut
from ogm_core.lattice import Lattice
from ogm_core.queries.footprints import MAX_CORNERS, WORDS, Footprints
from ogm_core.snapshot import MapSnapshot

MAX_BODY = 64 * 1024
"""The longest body of a check, bytes."""
_EXAMPLE = '{"points": [[1.5, 0.5]], "margin": 0.2}'


def read_check(body: bytes, lattice: Lattice) -> Footprints:
    """What the body of a request asks about.

    Raises:
        BadParameter: it is ill-formed, out of its limits, or asks too much.
    """
    given = _object(body)
    for name in given:
        if name not in ("points", "footprints", "margin"):
            raise BadParameter(f"{cut(name)}: unknown; there are: footprints, margin, points")
    if ("points" in given) == ("footprints" in given):
        raise BadParameter("points or footprints: one of them is needed, to say where")
    margin = _number("margin", given.get("margin", 0.0))
    if "points" in given:
        asked = [[_point("points", point)] for point in _listed("points", given["points"])]
        return Footprints(asked, margin, lattice)
    footprints = []
    for number, corners in enumerate(_listed("footprints", given["footprints"])):
        read = [_point("footprints", corner) for corner in _listed("footprints", corners)]
        if len(read) == 1:
            raise BadParameter(f"footprints: number {number}: 3 to {MAX_CORNERS} corners are needed, got 1")
        footprints.append(read)
    return Footprints(footprints, margin, lattice)


def words_of(asked: Footprints, part: MapSnapshot) -> list[str]:
    """What a map says: `part` holds all of its cells that are met."""
    return [WORDS[state] for state in asked.states(part.encode(trinary), part.rect).tolist()]


def _object(body: bytes) -> dict[str, Any]:
    try:
        given = orjson.loads(body)
    except orjson.JSONDecodeError as error:
        raise BadParameter(f"body: JSON is needed, such as {_EXAMPLE}: {cut(str(error))}") from None
    if not isinstance(given, dict):
        raise BadParameter(f"body: a JSON object is needed, such as {_EXAMPLE}")
    return given


def _listed(name: str, value: Any) -> Sequence[Any]:  # noqa: ANN401 - JSON
    if not isinstance(value, list):
        raise BadParameter(f"{name}: a list is needed, got {cut(repr(value))}")
    return value


def _point(name: str, value: Any) -> tuple[float, float]:  # noqa: ANN401 - JSON
    if not (isinstance(value, list) and len(value) == 2):
        raise BadParameter(f"{name}: a point [x, y] is needed, got {cut(repr(value))}")
    return _number(name, value[0]), _number(name, value[1])


def _number(name: str, value: Any) -> float:  # noqa: ANN401 - JSON
    if type(value) is not float and type(value) is not int:
        raise BadParameter(f"{name}: a number is needed, got {cut(repr(value))}")
    return float(value)
