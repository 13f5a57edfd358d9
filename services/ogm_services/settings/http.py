"""Settings of HTTP: where it is served, under which names, and who may write."""

from pathlib import Path
from typing import Annotated, Self

from pydantic import (
    AfterValidator,
    Field,
    FilePath,
    SecretStr,
    SerializationInfo,
    field_serializer,
    model_validator,
)

from ogm_core.errors import BadSetting
from ogm_services.settings.section import Section
from ogm_services.settings.values import (
    NONE,
    TOKEN,
    TOKEN_FORM,
    Count,
    HostNames,
    Networks,
    PageOrigins,
    RootPath,
    Token,
    WholeNumber,
    address_without_port,
)

SECRETS = "secrets"
"""Key of a serialisation's context: whether secrets are written out."""


def token_in(path: Path, given_as: str) -> bytes:
    """The token in a file.

    Raises:
        BadSetting: it cannot be read, or holds none; the text names the setting or flag that it was given as.
    """
    try:
        token = path.read_bytes().strip()
    except OSError as error:
        raise BadSetting(f"{given_as}: {path}: cannot be read: {error.strerror}") from None
    if not TOKEN.fullmatch(token.decode("latin-1")):
        raise BadSetting(f"{given_as}: {path}: {TOKEN_FORM} is needed, on one line")
    return token


class HttpSettings(Section):
    """Where the mapper serves HTTP, under which names, and the token that guards writes.

    Port 0 picks a free one. `hosts` are names besides the machine's own. `root_path` is the path that all of
    it is served under, `forwarded_allow_ips` are the proxies whose X-Forwarded-* are believed, and
    `cors_origins` other origins whose pages may ask. `max_live` WebSocket clients are served at a time.
    `token_file` holds the token, on one line; a relative path starts at the working folder.
    """

    host: Annotated[str, AfterValidator(address_without_port)] = "127.0.0.1"
    port: Annotated[WholeNumber, Field(ge=0, le=65535)] = 8000
    hosts: HostNames = ()
    root_path: Annotated[RootPath | None, NONE] = None
    forwarded_allow_ips: Networks = ()
    max_live: Count = 64
    cors_origins: PageOrigins = ()
    token: Annotated[Token | None, NONE] = None
    token_file: Annotated[FilePath | None, NONE] = None

    @model_validator(mode="after")
    def _one_token(self) -> Self:
        if self.token is not None and self.token_file is not None:
            raise BadSetting("http.token, http.token_file: give one of the two")
        return self

    @field_serializer("token")
    def _masked(self, token: SecretStr | None, info: SerializationInfo) -> str | None:
        told = info.context is not None and info.context.get(SECRETS)
        return None if token is None else token.get_secret_value() if told else str(token)

    def write_token(self) -> bytes | None:
        """The token that writes over HTTP must carry; None if they need none.

        Raises:
            BadSetting: the file of the token cannot be read, or holds none.
        """
        if self.token_file is None:
            return None if self.token is None else self.token.get_secret_value().encode()
        return token_in(self.token_file, "http.token_file")
