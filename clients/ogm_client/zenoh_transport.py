"""Zenoh transport: a mapper reached over Zenoh."""

import contextlib
import time
from collections.abc import Callable, Mapping
from typing import cast

import msgpack
import zenoh

from ogm_client.errors import BadReply, ClientError, MapperError, PartialMap, nobody
from ogm_client.missing_shares import in_attachment
from ogm_client.session import NetworkConfig, is_secured, open_session
from ogm_client.transport import (
    MAX_PROBLEM_BYTES,
    Limits,
    MapReply,
    Parameters,
    map_reply,
    mapper_error,
    partial_reply,
    printable,
    too_long,
)
from ogm_client.zenoh_errors import reason
from ogm_core.wire.keys import MapKeys, Query, Service, Write
from ogm_core.wire.map_update import MAX_CELL_BYTES

_TIMED_OUT = b"Timeout"
"""Zenoh's own error reply, when a queryable took the query and did not finish in time."""
_MAX_ATTACHMENT_BYTES = 4096
MAX_TOLD_BYTES = MAX_CELL_BYTES // 2
"""The longest update that is heard, bytes: those of a mapper are half as long."""
_OTHER_GATEWAY = "other-gateway"
"""The problem of who leaves the answer to another one, which has been asked, too."""
_AT_ONCE = 0.001
"""Of a question without any time left, s: Zenoh takes 0 for its own default."""


class ZenohTransport:
    """Gets on the keys of the map named `map_name`."""

    def __init__(
        self, network: NetworkConfig, map_name: str, limits: Limits, session: zenoh.Session | None
    ) -> None:
        """Connect as `network` says, or use an open `session`, which stays open; `limits` of an answer.

        Raises:
            BadSetting: the map's name, the address or the configuration file is ill-formed.
            CannotConnect: nothing takes connections at the address.
        """
        self._keys = MapKeys(map_name)
        self._limits = limits
        self._owns_session = session is None
        self._where = network.where if session is None else "on the open session"
        self._session = open_session(network) if session is None else session

    def fetch(self, name: str, parameters: Parameters) -> bytes:
        """The bytes of one of NAMES."""
        sample = self._get(*_asked(name, parameters), self._deadline())
        content = _content(name, sample.payload, self._limits.bytes_of(name))
        if "." in name and "complete" not in parameters and (missing := in_attachment(_attachment(sample))):
            raise PartialMap(content, missing)
        return content

    def fetch_described(self, name: str, parameters: Parameters) -> tuple[bytes, Mapping[str, object]]:
        """The bytes of one of NAMES that shows the map, and what the mapper says of it, unchecked."""
        sample = self._get(*_asked(name, parameters), self._deadline())
        return _content(name, sample.payload, self._limits.bytes_of(name)), _attachment(sample)

    def fetch_map(self, parameters: Parameters, name: str = "map.npz") -> MapReply:
        """map.npz, or another archive, with its version."""
        return self._fetch_map(parameters, self._deadline(), name)

    def ask(self, name: Query, body: bytes) -> bytes:
        """What is answered to a question that is a JSON body."""
        sample = self._get(name, {}, self._deadline(), body)
        return _content(name, sample.payload, self._limits.bytes_of(name))

    def write(self, name: Write, parameters: Parameters) -> bytes:
        """Change something; the bytes of what is answered."""
        sample = self._get(name, parameters, self._deadline())
        return _content(name, sample.payload, self._limits.bytes_of(name))

    def hear_updates(self, heard: Callable[[bytes], None]) -> Callable[[], None]:
        """Have every update that the mapper puts handed to `heard`, by Zenoh's thread; what ends that."""

        def on_sample(sample: zenoh.Sample) -> None:
            if len(sample.payload) <= MAX_TOLD_BYTES:
                heard(sample.payload.to_bytes())

        try:
            subscriber = self._session.declare_subscriber(
                self._keys.updates, zenoh.handlers.Callback(on_sample, indirect=False)
            )
        except zenoh.ZError as error:
            raise ClientError(f"{self._keys.updates}: not heard: {reason(error)}") from error

        def end() -> None:
            # A session that was closed has ended it already.
            with contextlib.suppress(zenoh.ZError):
                subscriber.undeclare()  # type: ignore[no-untyped-call]

        return end

    def close(self) -> None:
        """Close the session, if it is ours; closing twice does nothing."""
        if self._owns_session:
            self._session.close()  # type: ignore[no-untyped-call]

    def _deadline(self) -> float:
        return time.monotonic() + self._limits.timeout

    def _fetch(self, name: str, parameters: Parameters, deadline: float) -> bytes:
        sample = self._get(*_asked(name, parameters), deadline)
        return _content(name, sample.payload, self._limits.bytes_of(name))

    def _fetch_map(self, parameters: Parameters, deadline: float, name: str = "map.npz") -> MapReply:
        sample = self._get(*_asked(name, parameters), deadline)
        meta = _attachment(sample)
        npz = _content(name, sample.payload, self._limits.max_bytes)
        if missing := in_attachment(meta):
            return partial_reply(npz, missing, meta.get("stamp"))
        return map_reply(npz, *(meta.get(name) for name in ("epoch", "run", "revision", "stamp")))

    def _get(
        self, service: Service, parameters: Parameters, deadline: float, body: bytes | None = None
    ) -> zenoh.Sample:
        """The first answer; a mapper answers once."""
        key = self._keys.service(service)
        selector = zenoh.Selector(key, ";".join(f"{name}={value}" for name, value in parameters.items()))
        left = max(deadline - time.monotonic(), _AT_ONCE)
        try:
            # Without consolidation an answer comes at once, whoever else took the question and keeps silent.
            replies = self._session.get(
                selector, timeout=left, consolidation=zenoh.ConsolidationMode.NONE, payload=body
            )
        except zenoh.ZError as error:
            raise ClientError(f"{key}: not asked: {reason(error)}") from error
        refused: MapperError | None = None
        for reply in replies:
            if reply.ok is not None:
                return reply.ok
            if reply.err is not None:
                payload = _content(f"error reply to {service}", reply.err.payload, MAX_PROBLEM_BYTES)
                if payload != _TIMED_OUT:
                    refused = mapper_error(service, payload)
                    if refused.type != _OTHER_GATEWAY:
                        break
        if refused is not None:
            raise refused
        timeout, over = self._limits.timeout, time.monotonic() - deadline
        secured = is_secured(self._session)
        raise nobody(self._keys.map_name, self._where, timeout, timeout + over, secured=secured)


def _asked(name: str, parameters: Parameters) -> tuple[Service, Parameters]:
    """The queryable of one of NAMES, and its parameters, of which the format may be one."""
    service, _, form = name.partition(".")
    return cast(Service, service), {"format": form, **parameters} if form else parameters


def _content(what: str, payload: zenoh.ZBytes, limit: int) -> bytes:
    """The bytes of a payload, of which no copy is made before its length is known."""
    if len(payload) > limit:
        raise too_long(what, limit)
    return payload.to_bytes()


def _attachment(sample: zenoh.Sample) -> dict[str, object]:
    packed = sample.attachment
    content = b"" if packed is None else _content("what goes with the map", packed, _MAX_ATTACHMENT_BYTES)
    try:
        meta = msgpack.unpackb(content)
    except (ValueError, TypeError, OverflowError, RecursionError, msgpack.UnpackException) as error:
        said = printable(str(error))
        raise BadReply(f"{sample.key_expr}: the attachment is not MessagePack ({said})") from error
    if not isinstance(meta, dict):
        raise BadReply(f"{sample.key_expr}: a map is needed as the attachment, got {type(meta).__name__}")
    return meta
