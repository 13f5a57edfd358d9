"""`ogm forget`: a robot left out of a running mapper's map.

It imports what it needs when it runs, so that `ogm --help` answers at once.
"""

import json
from typing import Annotated

import typer

from ogm_services.commands.write_flags import WriteFlags
from ogm_services.settings.flag_groups import with_flag_groups
from ogm_services.settings.flags import ClientFlags

RobotName = Annotated[str, typer.Argument(metavar="ROBOT", help="Its name.", show_default=False)]


@with_flag_groups
def forget(network: ClientFlags, asked: WriteFlags, robot: RobotName) -> None:
    """Leave a robot out of the map, as one that was lost: the map is that of all others' scans.

    The mapper must keep robots apart (--separate-robots). Stop the robot before: what it sends is added anew.
    """
    with asked.client(network) as client:
        left = client.forget(robot)
    if asked.as_json:
        typer.echo(json.dumps({"robots": left}))
    else:
        typer.echo(f"{robot} is left out of the map; still in it: {', '.join(left) or 'nobody'}")
