"""Values of settings: what they can be, how they are written as text, and the presets."""

import difflib
import ipaddress
import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, SecretStr

from ogm_core.cells.thresholds import OCCUPIED_ABOVE
from ogm_core.errors import cut
from ogm_core.lattice import Region
from ogm_core.types import Pose
from ogm_core.wire.keys import DEFAULT_ADDRESS

Preset = Literal["lab"]
LogLevel = Literal["debug", "info", "warning", "error"]
LogFormat = Literal["text", "json"]

PRESETS: Mapping[str, Mapping[str, Any]] = {
    "lab": {
        "resolution": 0.1,
        "p_prior": 0.5,
        "p_occ": 0.7,
        "p_free": 0.3,
        "l_min": -8.0,
        "l_max": 8.0,
        "alpha": 0.2,
        "sensor_model": "beam",
        "cell_model": "log_odds",
        "traversal": "bresenham",
        "cells": "float64",
        "bounds": [-10.0, -10.0, 10.0, 10.0],
        "outside": "drop",
    }
}
"""Map settings that replace the defaults, by the preset's name."""

AUTO = "auto"
MAX_THREADS = 64

OF_LOG_ODDS = ("traversal", "cells", "p_prior", "p_occ", "p_free", "l_min", "l_max")
"""Map settings that say how log odds are kept and changed: another cell model has none of them."""


DECIMAL = r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?"
"""Pattern of a number in decimal digits."""
_NUMBER = re.compile(rf"\s*{DECIMAL}\s*", re.ASCII)


_NAME_OF_HOST = re.compile(r"[A-Za-z0-9_\-]+(\.[A-Za-z0-9_\-]+)*\.?")
_ORIGIN = re.compile(
    r"(?P<scheme>https?)://([a-z0-9_\-]+(\.[a-z0-9_\-]+)*|\[[0-9a-f:.]+\])(:(?P<port>[1-9][0-9]{0,4}))?"
)
_USUAL_PORTS = {"http": "80", "https": "443"}
"""They are not sent."""
TOKEN = re.compile(r"[A-Za-z0-9\-._~+/]{16,512}=*")
"""A bearer token (RFC 6750, section 2.1); shorter ones are soon guessed."""
TOKEN_FORM = "a token of 16 to 512 letters, digits and - . _ ~ + /"

ROOT_PATH = re.compile(r"(/(?!\.{1,2}(/|$))[A-Za-z0-9._~\-]+)+")
ROOT_PATH_FORM = "a path such as /maps/hall, without a slash at its end"


def parse_number(text: str) -> float:
    """A number in decimal digits; float alone would also take what only Python writes so, such as 1_0 for 10.

    Raises:
        ValueError: it is something else.
    """
    if not _NUMBER.fullmatch(text):
        raise ValueError(f"a number is needed, got {cut(text)!r}")
    return float(text)


def no_switch(value: object) -> object:
    """The value of a number as it is given.

    Raises:
        ValueError: it is true or false, which pydantic would take for 1 or 0.
    """
    if isinstance(value, bool):
        raise ValueError("a number is needed")  # noqa: TRY004 (pydantic collects ValueErrors only)
    return value


def _named(value: object) -> object:
    """The path of a folder as it is given.

    Raises:
        ValueError: it is empty, which pydantic would take for the working folder.
    """
    if value == "":
        raise ValueError("a path is needed")
    return value


def address_without_port(text: str) -> str:
    """The address or name of a host as it is given.

    Raises:
        ValueError: it is neither, such as a URL, or has a port.
    """
    try:
        ipaddress.ip_address(text)
    except ValueError:
        if not _NAME_OF_HOST.fullmatch(text):
            raise ValueError(
                "an address without a port is needed, such as 127.0.0.1; the port is http.port (--http-port)"
            ) from None
    return text


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The known name that an unknown one is closest to, as a part of a sentence; "" if none is close."""
    close = difflib.get_close_matches(name, known, n=1)
    return f" (did you mean {close[0]}?)" if close else ""


def parse_region(value: object) -> Region:
    """Region from the text XMIN,YMIN,XMAX,YMAX or from a list of four numbers, m.

    Raises:
        ValueError: it is neither.
    """
    parts = value.split(",") if isinstance(value, str) else value
    try:
        if (
            isinstance(parts, list | tuple)
            and len(parts) == 4
            and not any(isinstance(p, bool) for p in parts)
        ):
            return Region(*(parse_number(p) if isinstance(p, str) else float(p) for p in parts))
    except (TypeError, ValueError):
        pass
    raise ValueError("four numbers XMIN,YMIN,XMAX,YMAX are needed")


def parse_pose(value: object) -> Pose:
    """Pose from the text X,Y,THETA or from a list of three numbers; m and rad.

    Raises:
        ValueError: it is neither, or a number is not finite.
    """
    parts = value.strip("[ ]").split(",") if isinstance(value, str) else value
    try:
        if (
            isinstance(parts, list | tuple)
            and len(parts) == 3
            and not any(isinstance(p, bool) for p in parts)
        ):
            pose = Pose(*map(float, parts))
            if all(map(math.isfinite, pose)):
                return pose
    except (TypeError, ValueError):
        pass
    raise ValueError("three finite numbers X,Y,THETA (m, m, rad) are needed")


def _none_from_text(value: object) -> object:
    return None if isinstance(value, str) and value.lower() == "none" else value


def _whole_from_text(value: object) -> object:
    """Let 1e8 be written for 100000000 (YAML takes it for text, too); pydantic judges the rest."""
    try:
        return float(value) if isinstance(value, str) and "e" in value.lower() else value
    except ValueError:
        return value


def _threads(value: object) -> object:
    if isinstance(value, str) and value.strip().lower() == AUTO:
        return AUTO
    try:
        count = None if isinstance(value, bool | float) else int(str(value))
    except ValueError:
        count = None
    if count is None or not 1 <= count <= MAX_THREADS:
        raise ValueError(f"a whole number from 1 to {MAX_THREADS}, or {AUTO}, is needed")
    return count


def _list_from_text(value: object) -> object:
    return [part.strip() for part in value.split(",") if part.strip()] if isinstance(value, str) else value


def _endpoint(value: str) -> str:
    protocol, _, address = value.partition("/")
    if not (protocol.isidentifier() and address):
        raise ValueError(f"an endpoint such as {DEFAULT_ADDRESS} is needed")
    return value


def _host_name(value: str) -> str:
    if not _NAME_OF_HOST.fullmatch(value):
        raise ValueError("names of hosts such as map.example.org are needed, without a port")
    return value


def _root_path(value: str) -> str:
    if not ROOT_PATH.fullmatch(value):
        raise ValueError(f"{ROOT_PATH_FORM}, is needed")
    return value


def _network(value: str) -> str:
    try:
        return str(ipaddress.ip_network(value)).removesuffix("/32").removesuffix("/128")
    except ValueError:
        raise ValueError(
            "addresses and networks in digits are needed, such as 127.0.0.1 or 10.0.0.0/8"
        ) from None


def _page_origin(value: str) -> str:
    origin = _ORIGIN.fullmatch(value.lower())
    if value != "*" and (origin is None or origin["port"] == _USUAL_PORTS[origin["scheme"]]):
        raise ValueError(
            "origins as browsers send them are needed, such as https://map.example.org or "
            "http://localhost:3000, or * for all"
        )
    return value.lower()


def _token(value: SecretStr) -> SecretStr:
    if not TOKEN.fullmatch(value.get_secret_value()):
        raise ValueError(f"{TOKEN_FORM} is needed")
    return value


def _lower_case(value: object) -> object:
    return value.lower() if isinstance(value, str) else value


LOWER_CASE = BeforeValidator(_lower_case)
"""Beside a type of names: INFO is info."""
NONE = BeforeValidator(_none_from_text)
"""Beside a type that allows None: the text "none" means it, too."""
Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[Finite, Field(gt=0.0)]
PositiveOrInfinite = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[Finite, Field(ge=0.0)]
FreeBelow = Annotated[float, Field(gt=0.0, lt=OCCUPIED_ABOVE)]
Probability = Annotated[float, Field(ge=0.0, le=1.0)]
WholeNumber = Annotated[int, BeforeValidator(_whole_from_text)]
Count = Annotated[WholeNumber, Field(ge=1)]
Threads = Annotated[int | Literal["auto"], BeforeValidator(_threads)]
Folder = Annotated[Path, BeforeValidator(_named)]
Bounds = Annotated[Region, BeforeValidator(parse_region)]
Endpoint = Annotated[str, AfterValidator(_endpoint)]
HostNames = Annotated[
    tuple[Annotated[str, AfterValidator(_host_name)], ...], BeforeValidator(_list_from_text)
]
RootPath = Annotated[str, AfterValidator(_root_path)]
Networks = Annotated[tuple[Annotated[str, AfterValidator(_network)], ...], BeforeValidator(_list_from_text)]
PageOrigins = Annotated[
    tuple[Annotated[str, AfterValidator(_page_origin)], ...], BeforeValidator(_list_from_text)
]
Token = Annotated[SecretStr, AfterValidator(_token)]
Endpoints = Annotated[tuple[Endpoint, ...], BeforeValidator(_list_from_text)]
