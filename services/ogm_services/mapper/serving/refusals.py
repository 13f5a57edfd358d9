"""Refusals over HTTP: the response to an error that was raised on purpose.

Its own are the headers that Zenoh has none of; the body is that of `replies/problems.py`.
"""

from collections.abc import Mapping

from fastapi import Response

from ogm_core.errors import OgmError
from ogm_services.mapper.serving.ready_maps import NO_STORE
from ogm_services.replies.answer import Busy, TooManyGuesses, Unavailable
from ogm_services.replies.problems import MEDIA_TYPE, problem_of, status_of

RETRY_AFTER = "2"
"""When to ask a mapper again that is starting or busy, s."""


def refusal(error: OgmError, headers: Mapping[str, str] | None = None) -> Response:
    """Problem details, which nobody may keep; with when to come again if that helps."""
    later = {"Retry-After": RETRY_AFTER} if isinstance(error, Busy | Unavailable) else {}
    if isinstance(error, TooManyGuesses):
        later["Retry-After"] = str(error.wait)
    return Response(problem_of(error), status_of(error), {**NO_STORE, **later, **(headers or {})}, MEDIA_TYPE)
