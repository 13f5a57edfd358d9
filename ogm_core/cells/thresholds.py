"""Thresholds of probability: beyond which a cell counts as occupied, or as free."""

from ogm_core.errors import BadSetting

OCCUPIED_ABOVE = 0.65
FREE_BELOW = 0.196
"""Those of nav2's map_server. A map may have another `free_below`, which its cell model carries."""


def check_free_below(value: float) -> None:
    """Refuse what cannot separate free cells from others.

    Raises:
        BadSetting: it is no number between 0 and what is occupied.
    """
    if not 0.0 < value < OCCUPIED_ABOVE:
        raise BadSetting(
            f"free_below: a probability above 0 and below {OCCUPIED_ABOVE}, beyond which cells are occupied, "
            f"is needed, got {value:g}"
        )
