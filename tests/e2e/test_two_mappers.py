"""Two mappers of one map as processes: started together, and met again after one of them was frozen."""

import signal
import urllib.error
import urllib.request

import pytest


@pytest.fixture
def mapper(ogm, listener, endpoint):
    """`mapper()` starts a mapper that meets others through `listener`."""
    return lambda: ogm.start("mapper", "--http-port", 0, "--connect", endpoint)


def readyz(mapper):
    """Status and text of /readyz."""
    try:
        with urllib.request.urlopen(mapper.url + "readyz", timeout=30) as response:
            return response.status, response.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def tokens(session):
    replies = session.liveliness().get("ogm/v1/default/alive/mapper/*/*", timeout=10.0)
    return {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}


def test_of_two_that_are_started_together_exactly_one_stays(mapper, listener, ogm, eventually):
    for _ in range(3):
        both = [mapper(), mapper()]
        eventually(lambda both=both: any(one.process.poll() is not None for one in both), 120.0)
        (ended,) = (one for one in both if one.process.poll() is not None)
        (stays,) = (one for one in both if one is not ended)
        assert (ended.wait().code, ended.wait().out) == (1, "")
        assert "another mapper of map 'default' is alive" in ended.wait().err.splitlines()[-1]
        assert readyz(ogm.ready(stays)) == (200, "ok")
        assert len(tokens(listener)) == 1
        stays.stop()
        eventually(lambda: not tokens(listener))


def test_a_mapper_that_was_frozen_meets_its_heir_and_both_say_so(mapper, listener, ogm, eventually):
    first = mapper()
    frozen = ogm.ready(first)
    (theirs,) = tokens(listener)
    first.process.send_signal(signal.SIGSTOP)
    try:
        eventually(lambda: not tokens(listener))
        second = mapper()
        heir = ogm.ready(second)
        (mine,) = tokens(listener)
    finally:
        first.process.send_signal(signal.SIGCONT)
    for meets, other in ((frozen, mine), (heir, theirs)):
        eventually(lambda meets=meets: readyz(meets)[0] == 503)
        assert readyz(meets)[1] == f"another mapper of the map serves, too: {other}"
        meets.command.complains(f"another mapper of map 'default' serves, too ({other})")
        assert meets.status()["map"] == "default"  # it goes on answering
    first.stop()
    eventually(lambda: readyz(heir) == (200, "ok"))
    second.complains(f"the other mapper of map 'default' is gone ({theirs})")
