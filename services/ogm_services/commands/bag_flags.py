"""Flags of `ogm build` and `ogm replay` for bags."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from ogm_core.errors import BadInput
from ogm_services.commands.topic_flags import TOPICS, TopicFlags

if TYPE_CHECKING:
    from ogm_services.ros2.bag_reader import BagOptions


@dataclass(frozen=True)
class BagFlags:
    """Flags of what only a bag, which is there as a whole, can be asked for."""

    fixed_frame: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Of a bag: the frame that poses are in (default: map, else odom).",
            rich_help_panel=TOPICS,
        ),
    ] = None

    def options(self, topics: TopicFlags) -> "BagOptions | None":
        """How a bag is read, checked; None if nothing is said of it.

        Raises:
            BadInput: something is not allowed.
        """
        if self == BagFlags() and topics == TopicFlags():
            return None
        from ogm_services.ros2.bag_reader import BagOptions

        if topics.pose_topic and self.fixed_frame is not None:
            raise BadInput("--fixed-frame: it is for poses of tf; those of --pose-topic say theirs")
        return BagOptions(topics.options(), tuple(topics.scan_topic or ()), self.fixed_frame)
