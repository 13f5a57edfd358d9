"""First warm-up of a service: the kernels that it cannot do without, while it starts."""

import logging
import time

from ogm_core.grid_settings import GridSettings
from ogm_services.mapper.live.warm_up import warm_up
from ogm_services.runtime.compilation import compiling_until
from ogm_services.runtime.kernel_cache import begins_empty, lasts
from ogm_services.runtime.signals import held_signals

COMPILATION = {"beam": 10, "sector": 25}
"""How long the kernels of a sensor model take to compile, about, s."""

log = logging.getLogger(__name__)


def warm_up_first(settings: GridSettings, threads: int = 1) -> None:
    """`warm_up` before the first scan or question; signals end it. Says so if it is to take long."""
    empty, began = begins_empty(), time.monotonic()
    if empty:
        often, seconds = ", once for this version" if lasts() else "", COMPILATION[settings.sensor_model]
        log.info("compiling the map's kernels%s: about %d s", often, seconds)
    with held_signals() as held, compiling_until(lambda: bool(held)):
        warm_up(settings, threads)
    if empty:
        log.info("compiled the map's kernels in %.0f s", time.monotonic() - began)
