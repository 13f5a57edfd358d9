"""The package mcap (the extra `ros2`), which writes MCAP files; loaded when the first one is written."""

import io
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any

from ogm_core.errors import MissingExtra
from ogm_core.ros2 import mcap_records


def mcap_package() -> SimpleNamespace:
    """Its `Writer`, and `RECORDS`: what makes of a record's bytes the record, by kind.

    Raises:
        MissingExtra: it is not installed.
    """
    try:
        from mcap import data_stream, records, writer
    except ImportError as error:
        raise MissingExtra("MCAP recordings need the package mcap: pip install 'zenoh-ogm[ros2]'") from error

    def read(reads: Callable[..., Any], record: bytes, *, sized: bool = False) -> Any:  # noqa: ANN401
        stream = data_stream.ReadDataStream(io.BytesIO(record))
        return reads(stream, len(record)) if sized else reads(stream)

    kinds: dict[int, Any] = {
        mcap_records.HEADER: records.Header,
        mcap_records.SCHEMA: records.Schema,
        mcap_records.CHANNEL: records.Channel,
        mcap_records.ATTACHMENT: records.Attachment,
        mcap_records.METADATA: records.Metadata,
    }
    made = {kind: partial(read, record.read) for kind, record in kinds.items()}
    made[mcap_records.MESSAGE] = partial(read, records.Message.read, sized=True)
    return SimpleNamespace(Writer=writer.Writer, RECORDS=made)
