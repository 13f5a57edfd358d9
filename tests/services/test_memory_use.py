"""What a mapper holds in memory is counted by kind, and known in words."""

from ogm_services.runtime.memory import MemoryUse


def test_it_is_counted_by_kind_at_the_moment_of_the_question():
    memory, queue = MemoryUse(1000), [b"abc"]
    memory.add("map", lambda: 500)
    memory.add("queue", lambda: sum(map(len, queue)), 62)
    assert (memory.held(), memory.total()) == ({"map": 500, "queue": 3}, 503)
    queue.append(b"defg")
    assert (memory.held(), memory.total()) == ({"map": 500, "queue": 7}, 507)
    assert memory.limits() == {"map": None, "queue": 62}


def test_a_share_is_smaller_where_there_is_little_memory():
    assert MemoryUse(6 * 1024**3).share(256 * 1024**2) == 256 * 1024**2
    assert MemoryUse(1600).share(256) == 100
    assert MemoryUse(1).share(256) == 1


def test_in_words_the_largest_comes_first_and_what_holds_nothing_is_left_out():
    memory = MemoryUse(1)
    assert memory.in_words() == "nothing is held"
    for kind, count in (("queue", 2048), ("recent", 0), ("map", 812 * 1024**2)):
        memory.add(kind, lambda count=count: count)
    assert memory.in_words() == "map 812 MiB, queue 2 KiB"


def test_what_can_be_made_anew_is_in_nobodys_way_and_goes_when_all_is_full():
    memory, held = MemoryUse(100), {"map": 60, "caches": 30}
    memory.add("map", lambda: held["map"])
    memory.add("caches", lambda: held["caches"], let_go=lambda: held.update(caches=0))
    assert memory.left() == 40
    memory.make_room()
    assert memory.total() == 90
    held["map"] = 71
    assert (memory.left(), memory.total()) == (29, 101)
    memory.make_room()
    assert (memory.left(), memory.total()) == (29, 71)
