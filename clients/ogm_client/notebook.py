"""HTML of a map in a notebook: its picture above a scale bar and a line that says what it is."""

import base64
import math

from ogm_core.files.map_files import encode_png
from ogm_core.pictures.scale_bar import round_length
from ogm_core.snapshot import MapSnapshot

LARGEST = 800
"""No side of the picture is longer, pixels: larger maps are shrunk."""
COMFORTABLE = 480
"""Smaller maps are enlarged by a whole factor, up to this many pixels."""
BAR_SHARE = 0.2
"""The scale bar is about this much of the map's width."""

_LABEL = 80
_FOOT = 24
_LINES = 'fill="none" stroke="currentColor"'
_STYLE = "font-family: sans-serif; font-size: 12px"


def html_of(snap: MapSnapshot) -> str:
    """HTML that shows a map, north up: an SVG that holds a PNG, and a caption. Loads nothing from elsewhere.

    Lines and letters take the page's own colour.
    """
    if snap.empty:
        return f'<div style="{_STYLE}">MapGrid: the map has no known cell yet, revision {snap.revision}</div>'
    return f'<div style="{_STYLE}">{_picture(snap)}<div>{_caption(snap)}</div></div>'


def _picture(snap: MapSnapshot) -> str:
    shown = snap.shrink(LARGEST)
    zoom = max(1, COMFORTABLE // max(shown.width, shown.height))
    width, height = shown.width * zoom, shown.height * zoom
    length = round_length(snap.width * snap.resolution * BAR_SHARE)
    bar = length / shown.resolution * zoom
    whole, high = max(width, math.ceil(bar) + _LABEL), height + _FOOT
    png = base64.b64encode(encode_png(shown)).decode()
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{whole}" height="{high}"'
        f' viewBox="0 0 {whole} {high}" style="max-width: 100%; height: auto"'
        f' role="img" aria-label="{_caption(snap)}">'
        f'<image width="{width}" height="{height}" style="image-rendering: pixelated"'
        f' href="data:image/png;base64,{png}"/>'
        f'<rect x="0.5" y="0.5" width="{width - 1}" height="{height - 1}" {_LINES} stroke-opacity="0.3"/>'
        f'<path d="M1 {height + 7}v10m0 -5h{bar:.6g}m0 -5v10" {_LINES}/>'
        f'<text x="{bar + 8:.6g}" y="{height + 16}" fill="currentColor">{length:g} m</text>'
        "</svg>"
    )


def _caption(snap: MapSnapshot) -> str:
    x, y = snap.origin
    return (
        f"MapGrid, {snap.width} × {snap.height} cells of {snap.resolution:g} m = "
        f"{snap.width * snap.resolution:.6g} × {snap.height * snap.resolution:.6g} m, "
        f"lower-left corner ({x:.6g}, {y:.6g}), revision {snap.revision}"
    )
