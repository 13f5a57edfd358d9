"""The package mcap (the extra `ros2`), as far as it is used; loaded when the first file is met."""

from types import SimpleNamespace

from ogm_core.errors import MissingExtra

MAGIC = b"\x89MCAP0\r\n"
"""What an MCAP file begins with, and, if it was finished, ends with."""


def mcap_package() -> SimpleNamespace:
    """Its writer, its readers and its records.

    Raises:
        MissingExtra: it is not installed.
    """
    try:
        from mcap import exceptions, reader, records, stream_reader, writer
    except ImportError as error:
        raise MissingExtra("MCAP recordings need the package mcap: pip install 'zenoh-ogm[ros2]'") from error
    return SimpleNamespace(
        Writer=writer.Writer,
        make_reader=reader.make_reader,
        StreamReader=stream_reader.StreamReader,
        breakup_chunk=stream_reader.breakup_chunk,
        TooLong=exceptions.RecordLengthLimitExceeded,
        Attachment=records.Attachment,
        Header=records.Header,
        Metadata=records.Metadata,
        Schema=records.Schema,
        Channel=records.Channel,
        Chunk=records.Chunk,
        Message=records.Message,
    )
