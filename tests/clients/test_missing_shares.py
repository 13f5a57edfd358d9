"""What a gateway says of missing shares, as a client reads it: in headers, and in attachments."""

import pytest

from ogm_client.errors import BadReply
from ogm_client.missing_shares import MissingShare, in_attachment, in_headers


def test_shares_in_headers():
    assert in_headers({}) == ()
    told = {"OGM-Missing": "1;since=5, 12;since=70", "OGM-Missing-Bounds": "0.0,,,-3.2; ,,1e-05,"}
    assert in_headers(told) == (
        MissingShare(1, 5, (0.0, None, None, -3.2)),
        MissingShare(12, 70, (None, None, 1e-05, None)),
    )


@pytest.mark.parametrize(
    ("missing", "bounds"),
    [
        ("1", ",,,"),
        ("1;since=5", ",,"),
        ("1;since=5", ""),
        ("1;since=5,2;since=6", ",,,"),
        ("1;since=5", "x,,,"),
    ],
)
def test_ill_formed_headers(missing, bounds):
    with pytest.raises(BadReply, match="OGM-Missing"):
        in_headers({"OGM-Missing": missing, "OGM-Missing-Bounds": bounds})


def test_shares_in_attachments():
    assert in_attachment({"epoch": "e"}) == ()
    told = {"missing": [{"share": 3, "bounds": [None, 0, 1.5, None], "since": 9}]}
    assert in_attachment(told) == (MissingShare(3, 9, (None, 0, 1.5, None)),)


@pytest.mark.parametrize(
    "missing",
    [5, ["x"], [{"share": 1}], [{"share": 1, "since": 2, "bounds": [None, None, None, True]}], [{}] * 1025],
)
def test_ill_formed_attachments(missing):
    with pytest.raises(BadReply, match="missing"):
        in_attachment({"missing": missing})
