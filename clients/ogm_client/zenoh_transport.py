"""Zenoh transport: a mapper reached over Zenoh."""

from collections.abc import Mapping

import msgpack
import zenoh

from ogm_client.errors import BadReply, ClientError, nobody
from ogm_client.session import NetworkConfig, open_session, reason
from ogm_client.transport import MapReply, Parameters, Version, json_object, map_reply, mapper_error
from ogm_core.wire.keys import MapKeys, Service

_TIMED_OUT = b"Timeout"
"""Zenoh's own error reply, when a queryable took the query and did not finish in time."""
_SERVICE_OF: Mapping[str, Service] = {"cell": "cell", "quality": "quality", "status": "status"}


class ZenohTransport:
    """Gets on the keys of the map named `map_name`."""

    def __init__(
        self, network: NetworkConfig, map_name: str, timeout: float, session: zenoh.Session | None
    ) -> None:
        """Connect as `network` says, or use an open `session`, which stays open; `timeout` of an answer in s.

        Raises:
            BadSetting: the map's name, the address or the configuration file is ill-formed.
            CannotConnect: nothing takes connections at the address.
        """
        self._keys = MapKeys(map_name)
        self._timeout = timeout
        self._owns_session = session is None
        self._where = network.where if session is None else "on the open session"
        self._session = open_session(network) if session is None else session

    def fetch(self, name: str, parameters: Parameters) -> bytes:
        """The bytes of one of NAMES."""
        if name in _SERVICE_OF:
            return self._get(_SERVICE_OF[name], parameters).payload.to_bytes()
        file_format = name.removeprefix("map.")
        return self._get("map", {"format": file_format, **parameters}).payload.to_bytes()

    def fetch_map(self, parameters: Parameters) -> MapReply:
        """map.npz with its version."""
        sample = self._get("map", {"format": "npz", **parameters})
        meta = _attachment(sample)
        return map_reply(
            sample.payload.to_bytes(), meta.get("epoch"), meta.get("revision"), meta.get("stamp")
        )

    def fetch_map_after(self, seen: Version) -> MapReply | None:
        """map.npz, whole, if the map is no longer at version `seen`; else None."""
        status = json_object("status", self.fetch("status", {}))
        if (status.get("epoch"), status.get("revision")) == seen:
            return None
        reply = self.fetch_map({})
        return None if reply.version == seen else reply

    def reset(self) -> None:
        """Empty the map."""
        self._get("reset", {})

    def close(self) -> None:
        """Close the session, if it is ours; closing twice does nothing."""
        if self._owns_session:
            self._session.close()  # type: ignore[no-untyped-call]

    def _get(self, service: Service, parameters: Parameters) -> zenoh.Sample:
        """The first answer; a mapper answers once."""
        key = self._keys.service(service)
        selector = zenoh.Selector(key, ";".join(f"{name}={value}" for name, value in parameters.items()))
        try:
            replies = self._session.get(selector, timeout=self._timeout)
        except zenoh.ZError as error:
            raise ClientError(f"{key}: not asked: {reason(error)}") from error
        for reply in replies:
            if reply.ok is not None:
                return reply.ok
            if reply.err is not None:
                payload = reply.err.payload.to_bytes()
                if payload != _TIMED_OUT:
                    raise mapper_error(service, payload)
        raise nobody(self._keys.map_name, self._where, self._timeout)


def _attachment(sample: zenoh.Sample) -> dict[str, object]:
    packed = b"" if sample.attachment is None else sample.attachment.to_bytes()
    try:
        meta = msgpack.unpackb(packed)
    except (ValueError, msgpack.UnpackException) as error:
        raise BadReply(f"{sample.key_expr}: the attachment is not MessagePack ({error})") from error
    if not isinstance(meta, dict):
        raise BadReply(f"{sample.key_expr}: a map is needed as the attachment, got {type(meta).__name__}")
    return meta
