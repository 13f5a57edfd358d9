"""Cache of answers: for whoever asked when the map was not newer, of the same life of the same process."""

from ogm_services.mapper.live.live_map import Identity
from ogm_services.mapper.serving.answer_cache import AnswerCache
from ogm_services.replies.answer import Answer

OLD, NEW = Answer(b"old", "image/png"), Answer(b"new", "image/png")


def test_a_revision_is_not_that_of_another_run_or_epoch():
    now = Identity("e", "first", 5, 7)
    cache = AnswerCache(lambda: now)
    cache.keep("png", now, OLD)
    assert cache.find("png", now) is OLD
    assert cache.find("png", now._replace(revision=4)) is OLD
    assert cache.find("png", now._replace(revision=6)) is None
    for other in ({"run": "second"}, {"epoch": "f"}):
        for revision in (4, 5):
            assert cache.find("png", now._replace(**other, revision=revision)) is None
    now = Identity("e", "second", 4, 7)
    cache.keep("png", Identity("e", "first", 5, 7), OLD)  # made before, and late
    cache.keep("png", now, NEW)
    assert cache.find("png", now) is NEW
