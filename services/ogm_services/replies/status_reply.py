"""A mapper's reply to the question for its status, as values."""

from collections.abc import Mapping
from typing import Any

from pydantic import TypeAdapter, ValidationError

from ogm_client.errors import BadReply
from ogm_core.status import Status

_STATUS = TypeAdapter(Status)


def read_status(reply: Mapping[str, Any]) -> Status:
    """A status of what `MapClient.status` gives, of a mapper of any version.

    What only a newer mapper says is passed over; what an older one does not say yet has its default.

    Raises:
        BadReply: it lacks what every mapper says, or has something else in its place.
    """
    try:
        return _STATUS.validate_python(dict(reply))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        name = ".".join(map(str, first["loc"]))
        raise BadReply(f"status: {name}: {first['msg']}; is that a mapper of another version?") from error
