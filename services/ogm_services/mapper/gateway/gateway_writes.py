"""Writes of a gateway: all shares are emptied at once; all else that changes a map is refused."""

import logging
from collections.abc import Mapping
from functools import partial
from typing import get_args

from ogm_core.wire.keys import Write
from ogm_services.mapper.gateway.gathered_answers import GatheredAnswers
from ogm_services.mapper.gateway.share_statuses import ShareStatuses
from ogm_services.mapper.serving.writes import DoWrite
from ogm_services.mapper.shares.gathering import Gathering
from ogm_services.replies.answer import Answer, AskShares, Parameters, PartOfMap, refuse_parameters

RESET_TIMEOUT = 5.0
"""How long a share may take to finish the scans that came before a reset, s."""

log = logging.getLogger(__name__)


class GatewayWrites:
    """Each is done when it returns. Any thread."""

    def __init__(self, answers: GatheredAnswers, gathering: Gathering, statuses: ShareStatuses) -> None:
        self._answers = answers
        self._gathering = gathering
        self._statuses = statuses

    def by_name(self) -> Mapping[Write, DoWrite]:
        """All of them."""
        refused: dict[Write, DoWrite] = {name: partial(_refuse, name) for name in get_args(Write)}
        return {**refused, "reset": self.reset}

    def reset(self, given: Parameters, who: str) -> Answer:
        """Empty all shares: not at once, and a share that does not answer keeps its cells.

        Raises:
            BadParameter: there are parameters.
            PartOfMap: not all have answered with a new epoch; the text names the others.
        """
        refuse_parameters(given, "reset")
        self._answers.check_ready()
        before = self._gathering.newest.state.parts
        told = self._statuses.reset(RESET_TIMEOUT)
        left = [
            share
            for share, part in enumerate(before)
            if share not in told or (part is not None and told[share].epoch == part.epoch)
        ]
        if left:
            names = ", ".join(map(str, left))
            log.warning("%s has reset the map, but for share %s, which did not answer", who, names)
            raise PartOfMap(f"share {names} has not been emptied, the others have: ask again once it answers")
        log.info("%s has reset the map, all %d shares of it", who, len(before))
        return self._answers.status({})


def _refuse(name: Write, given: Parameters, who: str) -> Answer:
    del given, who
    raise AskShares(f"{name}: a gateway cannot do that in the maps of all shares together; it can reset them")
