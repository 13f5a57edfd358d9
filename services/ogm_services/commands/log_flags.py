"""Flags of a log that is read: what it does not say itself."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ogm_core.errors import BadInput
from ogm_services.settings.entries import FORM, check_for_whom

if TYPE_CHECKING:
    from ogm_services.commands.log_readers import ReadAs
    from ogm_services.ros2.bag_reader import BagOptions

_KINDS = (
    "Recording (.jsonl, .mcap), CARMEN log (.log, .clf) or g2o graph with scans (.g2o), .gz, too; a bag of "
    "ROS 2 (folder, .db3, .mcap) or ROS 1 (.bag)."
)
Log = Annotated[Path, typer.Argument(metavar="LOG", help=_KINDS)]
Logs = Annotated[list[Path], typer.Argument(metavar="LOG...", help=_KINDS)]


@dataclass(frozen=True)
class LogFlags:
    """Log flags of build, quality and replay; the reader of the log judges the values."""

    range_max: Annotated[
        float | None,
        typer.Option(
            metavar="METRES",
            help="Ranges from here on mean 'no return' in this log, whatever it says itself.",
            rich_help_panel="Log",
        ),
    ] = None
    robot: Annotated[
        list[str] | None,
        typer.Option(
            metavar=f"NAME|{FORM}",
            help="Rename the log's one robot; or what robots do not say: radius, in a bag origin, name "
            "(repeatable).",
            rich_help_panel="Log",
        ),
    ] = None
    odometry: Annotated[
        bool,
        typer.Option(
            "--odometry",
            help="Take poses from the ODOM lines of a CARMEN log, instead of those in its laser's lines.",
            rich_help_panel="Log",
        ),
    ] = False

    @property
    def name(self) -> str | None:
        """The new name of the log's robot.

        Raises:
            BadInput: there are several.
        """
        names = [text for text in self.robot or () if ":" not in text]
        if len(names) > 1:
            raise BadInput(f"--robot: the log's one robot gets one name, not {' and '.join(names)}")
        return names[0] if names else None

    @property
    def robots(self) -> list[str]:
        """What is said of robots, GLOB:KEY=VALUE,... of each."""
        return [text for text in self.robot or () if ":" in text]

    def read_as(self, bag: "BagOptions | None") -> "ReadAs":
        """How the log is to be read; `bag`, if it is one.

        Raises:
            BadInput: it has several names.
        """
        from ogm_services.commands.log_readers import ReadAs

        return ReadAs(self.range_max, self.name, self.odometry, bag)


def check_replayed(texts: list[str]) -> None:
    """Refuse what --robot says of a log's robots that is the mapper's to know.

    Raises:
        BadSetting: there is such a key.
    """
    mapper = "the mapper: ogm mapper --robot {!r}; here origin and name can be given, of a bag's robots"
    check_for_whom("robots", texts, "--robot", {"origin", "name"}, mapper)
