"""Ground truth of a map, as far as simulators tell it."""

import logging
from collections.abc import Iterable
from typing import Protocol

from ogm_core.errors import OgmError
from ogm_core.simulation.worlds import World, load_world
from ogm_core.wire.keys import MAX_TRUTH_BYTES
from ogm_services.runtime.limited_log import LimitedLog

MAX_NAME = 64
"""So much of a world's name is repeated in the log, characters."""

log = logging.getLogger(__name__)


class Text(Protocol):
    """What somebody has answered: bytes, or a payload of Zenoh, whose length is known before it is copied."""

    def __len__(self) -> int: ...

    def __bytes__(self) -> bytes: ...


class TrueWorld:
    """The world that the simulators of a map say they simulate.

    One thread calls `heard`, another may call `settle`; any may read `world`, which stays the same object as
    long as the same is told.
    """

    def __init__(self) -> None:
        self.world: World | None = None
        """The true world; None if nobody tells one."""
        self._read: dict[bytes, World | None] = {}
        """What was told last, in the order of the texts, as worlds; None where a text is not one."""
        self._last: World | None = None
        self._epoch = ""
        self._settled = False
        self._complaints = LimitedLog(log)

    def heard(self, epoch: str, texts: Iterable[Text]) -> None:
        """Take what simulators have just answered while the map was in that epoch.

        Simulators of different worlds are no truth of one map. Worlds are never mixed: the first well-formed
        text counts, in the order of their bytes, so that it is the same one whoever answers first. A text of
        MAX_TRUTH_BYTES may take some seconds to read; a longer one is not even copied.
        """
        told = sorted({bytes(text) for text in texts if self._short(text)})
        if told != list(self._read):
            self._read = {
                text: self._read[text] if text in self._read else self._world(text) for text in told
            }
            names = [world.name[:MAX_NAME] for world in self._read.values() if world is not None]
            if len(names) > 1:
                self._complaints.warning("simulators", f"they tell {len(names)} worlds; {names[0]!r} counts")
        if self._settled:
            return
        self.world = next((world for world in self._read.values() if world is not None), None)
        if epoch != self._epoch:
            self._epoch, self._last = epoch, None
        self._last = self.world or self._last

    def settle(self) -> None:
        """Nobody will be asked any more: what was told last of this epoch stays the truth.

        Simulators often end before their mapper does, and leave a map that is still to be judged.
        """
        self._settled = True
        self.world = self._last

    def _short(self, text: Text) -> bool:
        if len(text) <= MAX_TRUTH_BYTES:
            return True
        self._pass_over(
            f"its {len(text)} bytes are more than {MAX_TRUTH_BYTES}; the map's quality has no `truth`"
        )
        return False

    def _world(self, text: bytes) -> World | None:
        try:
            return load_world(text.decode())
        except (OgmError, UnicodeDecodeError) as error:
            self._pass_over(str(error))
            return None

    def _pass_over(self, reason: str) -> None:
        self._complaints.warning("a simulator's world", f"passed over: {reason}")
