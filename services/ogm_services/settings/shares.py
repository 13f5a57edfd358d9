"""Settings of a map that is cut into shares."""

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from ogm_core.errors import BadSetting
from ogm_core.shares import Cuts, Share
from ogm_services.settings.section import Section
from ogm_services.settings.values import NONE, Finite, WholeNumber, parse_number


def _numbers_from_text(value: object) -> Any:  # noqa: ANN401 (pydantic judges the rest)
    """Let 0,12.8 be written for [0, 12.8], and one number for a list of it."""
    if isinstance(value, str):
        return [parse_number(part) for part in value.split(",") if part.strip()]
    return [value] if isinstance(value, int | float) else value


Lengths = Annotated[tuple[Finite, ...], BeforeValidator(_numbers_from_text)]


MIN_GATHER_TIMEOUT, MAX_GATHER_TIMEOUT = 0.05, 10.0


class SharesSettings(Section):
    """Where a map is cut, m, and which of its shares a mapper has: see docs/fleet.md.

    A gateway waits `gather_timeout` s at most for what a share has to tell.
    """

    cuts_x: Lengths = ()
    cuts_y: Lengths = ()
    index: Annotated[Annotated[WholeNumber, Field(ge=0)] | None, NONE] = None
    gather_timeout: Annotated[Finite, Field(ge=MIN_GATHER_TIMEOUT, le=MAX_GATHER_TIMEOUT)] = 0.8

    @property
    def cuts(self) -> Cuts:
        """Where the map is cut.

        Raises:
            BadSetting: they do not rise.
        """
        return Cuts(self.cuts_x, self.cuts_y)

    def of_mapper(self) -> Share | None:
        """Which share a mapper has; None: the whole map, which is not cut.

        Raises:
            BadSetting: there is no such share, or it is not said which.
        """
        if self.index is not None:
            return Share(self.cuts, self.index)
        if self.cuts.count > 1:
            raise BadSetting(
                f"shares.index: this map is cut into {self.cuts.count} shares: say which one this mapper "
                "keeps, with --share K"
            )
        return None
