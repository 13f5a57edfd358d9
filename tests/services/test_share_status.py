"""`ogm status` of a share, and what a demo says of a map that is cut."""

from dataclasses import replace

import pytest
from rich.console import Console

from ogm_core.errors import BadSetting
from ogm_core.shares import Cuts, Share
from ogm_core.status import ScanCounts, ScansOfOthers, ShareState, StoreInfo
from ogm_services.commands.demo import run_demo
from ogm_services.commands.status import status_tables
from ogm_services.settings.settings import Settings
from status_json import STATUS


def shown(status):
    console = Console(width=120, record=True)
    for table in status_tables(status):
        console.print(table)
    return console.export_text()


def test_the_table_says_which_share_it_is_and_what_others_count():
    scans = replace(STATUS.scans, of_others=ScansOfOthers(border=3, elsewhere=5))
    share = replace(STATUS, share=Share(Cuts((0.0, 6.4)), 2).info(), scans=scans)
    text = shown(share)
    assert "2 of 3: x 6.4 to open, y open to open m" in text
    assert "3 border, 5 elsewhere" in text
    assert "of others" not in shown(STATUS)


def test_the_table_of_a_gateway_has_a_row_for_every_share():
    shares = [
        ShareState(
            0, [None, None, 0.0, None], "up", epoch="e", run="r", revision=12, overload=3, restored=False
        ),
        ShareState(
            1, [0.0, None, None, None], "missing", since=1_700_000_000_000_000_000, detail="other cuts"
        ),
    ]
    rows = [line.split() for line in shown(replace(STATUS, shares=shares)).splitlines()]
    assert ["0", "up", "no", "12", "3"] in rows
    (missing,) = [row for row in rows if row[:2] == ["1", "missing"]]
    assert missing[-2:] == ["other", "cuts"]


@pytest.mark.parametrize(
    ("restored", "said"),
    [(True, "; restored at the start"), (False, "; none there at the start"), (None, "")],
)
def test_the_table_says_how_far_the_map_is_stored_and_whether_it_was_at_the_start(restored, said):
    stored = replace(STATUS, store=StoreInfo(40, None, 2_500_000), restored=restored)
    (row,) = [line.split(maxsplit=1) for line in shown(stored).splitlines() if line.split()[:1] == ["stored"]]
    assert row[1].rstrip() == f"revision 40, 2.5 MB{said}"


@pytest.mark.parametrize(
    ("changes", "missing", "overload", "said"),
    [
        ({}, (), 0, "yes"),
        (
            {"received": 13},
            (),
            2,
            "no: 2 dropped by shares that had no time for them; 3 received, and",
        ),
        ({"received": 9}, (), 0, "no: 1 counted by the share that they are of, and not received by share 0"),
        ({}, (0, 1), 0, "no: share 0, 1 is missing"),
        ({}, (), None, "no: a share does not say how it is"),
    ],
)
def test_the_table_of_a_gateway_says_whether_scans_lack_in_shares(changes, missing, overload, said):
    scans = ScanCounts(**{"received": 10, "integrated": 6, "pending": 1, "dropped": {"limit": 3}} | changes)
    shares = [
        ShareState(k, [None] * 4, "missing" if k in missing else "up", overload=overload) for k in (0, 1)
    ]
    shares[1] = replace(shares[1], overload=0)
    status = replace(STATUS, scans=scans, shares=shares, complete=said == "yes")
    (row,) = [line for line in shown(status).splitlines() if line.split()[:1] == ["complete"]]
    assert row.split(maxsplit=1)[1].startswith(said)
    assert "complete" not in shown(STATUS)


@pytest.mark.parametrize("shares", [{"cuts_x": [0.0]}, {"index": 0}])
def test_a_demo_has_no_shares(shares):
    settings = Settings.model_validate({"map": {"reach": 5.0}, "shares": shares})
    with pytest.raises(BadSetting, match=r"^shares: a demo has one mapper"):
        run_demo(settings, world="lab", start=None, duration=None, out=None)
