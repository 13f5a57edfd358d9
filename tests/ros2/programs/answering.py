"""What the programs of this folder share: a line of JSON in, a line of JSON out, until there is no more."""

import json
import sys


def answer(answered):
    """`answered`: from what was asked to what is told, both of them dictionaries."""
    for line in sys.stdin:
        print(json.dumps(answered(json.loads(line))), flush=True)


def answer_by_verb(ends):
    """What is asked names a method of `ends` first, as {"put": "/scan", "cdr": "..."}."""
    answer(lambda asked: getattr(ends, next(iter(asked)))(asked) or {})
