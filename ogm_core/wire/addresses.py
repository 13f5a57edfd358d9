"""Addresses of mappers: what errors and logs show of them."""

import re

MASKED = "***"
"""Stands for what nobody is to read in an error or a log."""
_SECRET = re.compile(r"((?:private_key|password)\w*=)[^;#,\s]*")
_USER = re.compile(r"(\w+://)\S*@|(\w+/)?[^\s#]*@")


def masked(text: str) -> str:
    """Addresses without their secrets, and without a user before a host; hosts and ports as they are."""
    return _USER.sub(rf"\1\2{MASKED}@", _SECRET.sub(rf"\1{MASKED}", text))
