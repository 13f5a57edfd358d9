"""Damaged stores: an earlier exact state or a clear refusal, never a wrong map; and what repair saves."""

from tampering import tampered


def test_a_store_that_is_tampered_with_is_exact_or_refused(tmp_path):
    """Sixty places: bits, lengths, pages and rows, in the file and in its log."""
    found = tampered(60, tmp_path)
    results = {result for _, result, _ in found}
    assert results == {"exact", "refused"}
    assert sum(found.values()) == 60
    assert sum(count for (_, result, _), count in found.items() if result == "refused") >= 15
    assert {mended for _, _, mended in found} == {"exact", "in part", "nothing"}
