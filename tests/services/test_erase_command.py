"""`ogm erase`: what it asks a mapper for, over HTTP with a token and over Zenoh, and what it says."""

import json

import pytest
from typer.testing import CliRunner

from ogm_services.cli import app


@pytest.fixture
def ogm():
    return lambda *args: CliRunner().invoke(app, ["erase", *args], prog_name="ogm")


@pytest.fixture
def guarded(start_mapper, no_errors, tmp_path):
    """A mapper with the cross in it that wants a token over HTTP, and a file with that."""
    token = tmp_path / "token"
    token.write_text("0123456789abcdef" * 2)
    with start_mapper(map={"resolution": 0.5}, http={"token_file": str(token)}) as mapper:
        mapper.draw_cross()
        yield mapper, token


def known_cells(mapper):
    return sum(value >= 0 for value in mapper.http.get("/map.json").json()["data"])


def test_it_says_how_many_cells_were_known(guarded, ogm):
    mapper, token = guarded
    over_http = "--url", str(mapper.http.base_url), "--token-file", str(token)
    over_zenoh = "--url", mapper.endpoint, "--map", "hall"
    before = known_cells(mapper)
    for where, area, said in (
        (over_http, ("--region", "0.5,-0.1,3,0.6"), "4 cells erased\n"),
        (over_zenoh, ("--region", "-0.9,1.1,-0.6,1.9"), "0 cells erased\n"),  # a corner of the cross
        (over_zenoh, ("--polygon=-0.5,-0.1,0.1,-0.1,0.1,0.6,-0.6,0.6",), "1 cell erased\n"),
        (over_http, ("--polygon", "-0.1,1.1,0.4,1.1,0.4,2,-0.1,2", "--json"), {"cells": 2}),
    ):
        result = ogm(*area, *where)
        assert (result.exit_code, result.stderr) == (0, ""), result.stderr
        assert (json.loads(result.stdout) if "--json" in area else result.stdout) == said
    assert (known_cells(mapper), mapper.status()["revision"]) == (before - 7, 7)


def test_without_the_token_or_with_another_nothing_is_erased(guarded, ogm, tmp_path):
    mapper, _ = guarded
    other = tmp_path / "other"
    other.write_text("fedcba9876543210" * 2)
    for given in ((), ("--token-file", str(other))):
        result = ogm("--region=-9,-9,9,9", "--url", str(mapper.http.base_url), *given)
        assert result.exit_code == 1
        assert "token" in result.stderr
        assert len(result.stderr.splitlines()) == 1
    assert mapper.status()["revision"] == 3


def test_what_a_mapper_refuses_is_what_was_given(guarded, ogm):
    mapper, _ = guarded
    for area, said in (
        ("--region=7,7,9,9", "lies wholly outside the map"),
        ("--region=1,1,0,0", "region: xmin < xmax and ymin < ymax are needed"),
        ("--polygon=0,0,1,1", "polygon: x1,y1,x2,y2,... of 3 to 64 points is needed, got 4 numbers"),
    ):
        result = ogm(area, "--url", mapper.endpoint, "--map", "hall")
        assert (result.exit_code, said in result.stderr) == (2, True), result.stderr
    mapper.http.headers["Authorization"] = "Bearer " + "0123456789abcdef" * 2
    mapper.http.post("/reset").raise_for_status()
    result = ogm("--region=0,0,1,1", "--url", mapper.endpoint, "--map", "hall")
    assert (result.exit_code, "the map has no known cell" in result.stderr) == (1, True)
