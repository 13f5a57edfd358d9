"""Statuses and resets of shares: what a gateway asks of all of them beside their cells."""

import logging
from collections.abc import Iterable, Mapping

import zenoh

from ogm_client.errors import ClientError
from ogm_client.status_reply import read_status
from ogm_client.transport import mapper_error
from ogm_core.status import Status
from ogm_core.wire.keys import MapKeys, ShareService
from ogm_services.mapper.shares.share_answers import Asked, ask_shares
from ogm_services.runtime.limited_log import LimitedLog

log = logging.getLogger(__name__)


class ShareStatuses:
    """Asks all shares of a map how they are. Any thread."""

    def __init__(self, session: zenoh.Session, keys: MapKeys, count: int, timeout: float) -> None:
        """Of `count` shares each may take `timeout` s to answer."""
        self._session = session
        self._keys = keys
        self._count = count
        self._timeout = timeout
        self._log = LimitedLog(log)

    def ask(self, shares: Iterable[int]) -> dict[int, Status]:
        """The status of those of some shares that tell it in time."""
        return self._asked("status", shares, self._timeout)

    def reset(self, timeout: float) -> Mapping[int, Status]:
        """Empty every share; the status after it of each that has answered within `timeout` s."""
        return self._asked("reset", range(self._count), timeout)

    def _asked(self, service: ShareService, shares: Iterable[int], timeout: float) -> dict[int, Status]:
        found: dict[int, Status] = {}
        asked = dict.fromkeys(shares, Asked("", timeout))
        told = ask_shares(self._session, self._keys, service, asked)
        for answer in (answer for _, answers in told for answer in answers):
            try:
                if answer.refused:
                    raise mapper_error(service, answer.payload)
                status = read_status(answer.payload)
            except ClientError as error:
                self._log.warning(f"share {answer.share}", f"{service}: {error}")
                continue
            known = found.get(answer.share)
            # Of two processes of a share the one that started last counts.
            if known is None or status.uptime_s < known.uptime_s:
                found[answer.share] = status
        return found
