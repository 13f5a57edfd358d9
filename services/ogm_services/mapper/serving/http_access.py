"""Access over HTTP: by which names, through whom, and with what the mapper is asked."""

import ipaddress
import logging
import socket
from dataclasses import dataclass, field
from typing import Self

from ogm_services.mapper.serving.cross_origin import Origins
from ogm_services.settings.http import HttpSettings

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class HttpAccess:
    """Settings of HTTP, as far as they say who is answered.

    `hosts` are names by which it is asked, besides the machine's own; `root_path` is the path under which a
    proxy serves it, and `proxies` are the addresses and networks of those that are believed; pages of
    `origins` may ask, too; with a `token` writes must carry it.
    """

    hosts: tuple[str, ...] = ()
    root_path: str = ""
    proxies: tuple[str, ...] = ()
    origins: Origins = field(default_factory=Origins)
    token: bytes | None = None

    @classmethod
    def of(cls, settings: HttpSettings) -> Self:
        """What the settings say.

        Raises:
            BadSetting: the file of the token cannot be read, or holds none.
        """
        return cls(
            hosts=(*settings.hosts, settings.host),
            root_path=settings.root_path or "",
            proxies=settings.forwarded_allow_ips,
            origins=Origins(settings.cors_origins),
            token=settings.write_token(),
        )

    def url(self, listener: socket.socket, *, writes: bool = True) -> str:
        """Where a server on this socket is asked; warns if just anybody may empty its map, by `writes`."""
        host, port = listener.getsockname()[:2]
        if writes and self.token is None and not ipaddress.ip_address(host).is_loopback:
            log.warning(
                "HTTP on %s has no token: whoever reaches it may reset the map; set http.token_file", host
            )
        return f"http://{f'[{host}]' if ':' in host else host}:{port}/"
