"""Table of robots' topics, for the eye."""

from rich import box
from rich.console import Console
from rich.table import Table

from ogm_core.errors import printable
from ogm_core.ros2.topics import Topic

_USED = ("LaserScan", "PointCloud2", "TFMessage", "Odometry", "PoseStamped", "PoseWithCovarianceStamped")
"""Of these types something can be made; they are bold."""


def print_topics(topics: list[tuple[str, Topic]], looked: list[str]) -> None:
    """Print a row for each; without any, where was looked."""
    console = Console()
    if not topics:
        console.print("no topic was found on", markup=False)
        for where in looked:
            console.print(f"  {where}", markup=False)
        return
    table = Table(box=box.SIMPLE)
    for title in ("source", "domain", "topic", "type", "QoS", "node"):
        table.add_column(title, overflow="fold")
    for _, topic in topics:
        domain = "-" if topic.domain is None else str(topic.domain)
        used = topic.type.rpartition("/")[2] in _USED
        node = printable(topic.node) or "-"
        cells = (topic.form, domain, topic.name, printable(topic.type), str(topic.qos), node)
        table.add_row(*cells, style="bold" if used else None)
    console.print(table)
