"""The command `ogm replay` and its flags; what it does is in `replay`, which is loaded when it runs."""

import math
from typing import Annotated

import typer

from ogm_core.errors import BadInput
from ogm_services.commands.bag_flags import BagFlags
from ogm_services.commands.log_flags import Log, LogFlags, check_replayed
from ogm_services.commands.topic_flags import TopicFlags
from ogm_services.runtime.endings import INTERRUPTED
from ogm_services.runtime.loading import loading
from ogm_services.runtime.logged_service import logged_service
from ogm_services.settings.flag_groups import with_flag_groups
from ogm_services.settings.flags import ConfigFile, LoggingFlags, NetworkFlags, PrintConfig, settings_from


@with_flag_groups
def replay(
    log: Log,
    network: NetworkFlags,
    log_flags: LogFlags,
    topics: TopicFlags,
    bag: BagFlags,
    logging: LoggingFlags,
    config: ConfigFile = None,
    print_config: PrintConfig = False,
    speed: Annotated[
        str,
        typer.Option(metavar="FACTOR|max", help="1: as recorded, 2: twice as fast, max: as the mapper can."),
    ] = "1",
) -> None:
    """Publish a recorded log as its robots did."""
    factor = _speed(speed)
    settings = settings_from(config, network, logging, robots=log_flags.robots, print_config=print_config)
    check_replayed(log_flags.robots)
    with logged_service(*settings.log.as_given, interrupted=INTERRUPTED):
        with loading():
            from ogm_services.commands.replay import run_replay
        read_as = log_flags.read_as(bag.options(topics))
        run_replay(log, settings, speed=factor, read_as=read_as)


def _speed(text: str) -> float | None:
    """Factor of --speed; None for "max"."""
    if text == "max":
        return None
    try:
        factor = float(text)
    except ValueError:
        factor = math.nan
    if not 0.0 < factor < math.inf:
        raise BadInput(f"--speed: a number above 0, or max, is needed, got {text!r}")
    return factor
