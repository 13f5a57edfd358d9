"""Archives of arrays: what is announced is looked at before it is unpacked; it holds, or is refused."""

import io
import struct
import tracemalloc
import zipfile

import numpy as np
import pytest

from ogm_core.errors import BadInput, BadMapFile
from ogm_core.files.map_files import load_npz, read_npz

CELLS = np.array([[0.5, np.nan, -1.0], [2.0, 3.0, 4.0]], np.float32)
PLACE = {"resolution": np.array(0.05), "anchor": np.array([1.0, -2.0]), "offset": np.array([-3, 4], np.int64)}


def npy(array):
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def header(text, version=b"\x01\x00"):
    return b"\x93NUMPY" + version + struct.pack("<H", len(text)) + text


def archive(log_odds=None, *, method=zipfile.ZIP_DEFLATED, **members):
    """A map's archive; members are the bytes of .npy files."""
    contents = {name: npy(array) for name, array in PLACE.items()}
    contents["log_odds"] = npy(CELLS) if log_odds is None else log_odds
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as written:
        for name, content in (contents | members).items():
            written.writestr(f"{name}.npy", content)
    return file.getvalue()


def refusal(data, **options):
    """What is said of it, in one line, and that next to no memory was needed for it."""
    tracemalloc.start()
    try:
        with pytest.raises(BadInput) as caught:
            read_npz(data, **options)
        assert tracemalloc.get_traced_memory()[1] < 8e6
    finally:
        tracemalloc.stop()
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("order", ["C", "F"])
def test_the_cells_are_those_that_numpy_wrote(method, dtype, order):
    cells = np.asarray(CELLS, dtype, order=order)
    read = read_npz(archive(npy(cells), method=method))
    np.testing.assert_array_equal(read.log_odds, cells)
    assert read.log_odds.dtype == dtype
    assert (read.resolution, read.anchor, read.offset) == (0.05, (1.0, -2.0), (-3, 4))


def test_cells_of_many_pieces_are_read():
    cells = np.random.default_rng(3).normal(size=(700, 900)).astype(np.float32)
    np.testing.assert_array_equal(read_npz(archive(npy(cells))).log_odds, cells)
    assert read_npz(archive(npy(cells)), max_bytes=cells.nbytes).log_odds.nbytes == 2_520_000
    assert "its cells take 2520000 bytes, at most 2519999 are allowed" in refusal(
        archive(npy(cells)), max_bytes=cells.nbytes - 1
    )


def lied(data, name, size):
    """An archive whose directory says that a member has `size` bytes, unpacked."""
    with zipfile.ZipFile(io.BytesIO(data)) as read:
        true = read.getinfo(f"{name}.npy").file_size
    entry = data.index(b"PK\x01\x02", data.index(f"{name}.npy".encode()) + 1)
    while not data[entry + 46 :].startswith(f"{name}.npy".encode()):
        entry = data.index(b"PK\x01\x02", entry + 1)
    assert struct.unpack_from("<L", data, entry + 24) == (true,)
    return data[: entry + 24] + struct.pack("<L", size) + data[entry + 28 :]


def test_a_map_too_large_for_memory_is_refused_before_it_is_unpacked(tmp_path):
    """Two gigabytes that two megabytes announce."""
    start = header(b"{'descr': '<f4', 'fortran_order': False, 'shape': (16384, 32768), }\n")
    noise = np.random.default_rng(1).bytes(2_000_000)
    data = lied(archive(start + noise), "log_odds", len(start) + 2**31)
    assert "its cells take 2147483648 bytes, at most 1073741824 are allowed" in refusal(data)
    path = tmp_path / "bomb.npz"
    path.write_bytes(data)
    with pytest.raises(BadMapFile, match=rf"^{path}: its cells take"):
        load_npz(path)


def test_what_unpacks_to_more_than_was_announced_is_not_unpacked_on():
    bomb = archive(npy(CELLS) + bytes(30_000_000))
    assert "announces 24 bytes of numbers, and the archive 30000" in refusal(bomb)
    assert "Bad CRC-32" in refusal(lied(bomb, "log_odds", len(npy(CELLS))))


def test_what_announces_more_than_deflate_can_pack_is_not_unpacked():
    start = header(b"{'descr': '<f4', 'fortran_order': False, 'shape': (10000, 10000), }\n")
    size = len(start) + 400_000_000
    assert f"log_odds announces {size} bytes in" in refusal(
        lied(archive(start + bytes(100)), "log_odds", size)
    )


def test_what_ends_before_what_was_announced_is_refused():
    start = header(b"{'descr': '<f4', 'fortran_order': False, 'shape': (100, 100), }\n")
    short = archive(start + np.random.default_rng(1).bytes(39_000))
    assert "log_odds ends too early" in refusal(lied(short, "log_odds", len(start) + 40_000))


@pytest.mark.parametrize(
    "log_odds",
    [
        b"",
        b"\x93NUMPY",
        header(b"(" * 9000),
        header(b"{'descr': '<f4', 'fortran_order': False, 'shape': (" + b"(" * 5000),
        header(b"{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3" + b"0" * 5000 + b"), }\n"),
        header(b"{'descr': '<f4', 'fortran_order': False, 'shape': (-2, 3), }\n"),
        header(b"{'descr': '<f4', 'fortran_order': False, 'shape': (2L, 3), }\n"),
        header(b"{'descr': '<f3', 'fortran_order': False, 'shape': (2, 3), }\n"),
        header(b"{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (2, 3), }\n"),
        header(b"{'descr': '|O', 'fortran_order': False, 'shape': (1, 1), }\n") + b"cos\nsystem\n.",
        header(b"{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }\n", b"\x02\x00")
        + CELLS.tobytes(),
        header(b"{'shape': (2, 3), 'fortran_order': False, 'descr': '<f4'\n") + CELLS.tobytes(),
        npy(CELLS)[:-1],
        npy(CELLS) + b"\0",
        npy(np.array([[None]], object)),
    ],
)
def test_what_does_not_begin_as_an_array_of_numbers_is_refused(log_odds):
    assert refusal(archive(log_odds)).startswith("map.npz: not a map that was saved here and can be read (")


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_other_packings_are_refused(method):
    """Their unpackers in zipfile know no limit."""
    assert f"packed by method {method}, deflate is needed" in refusal(archive(method=method))


def test_an_archive_that_lists_many_members_is_refused():
    many = archive(**{f"a{k}": b"" for k in range(65)})
    assert "it lists 69 members" in refusal(many)
    count = many.rindex(b"PK\x05\x06") + 10
    fewer = many[:count] + struct.pack("<H", 4) + many[count + 2 :]  # zipfile goes by the bytes
    assert refusal(lied_directory(fewer)).endswith("too many for a map)")


def lied_directory(data):
    """An archive whose directory seems to be long."""
    at = data.rindex(b"PK\x05\x06") + 12
    return data[:at] + struct.pack("<L", 65 * 1024) + data[at + 4 :]


@pytest.mark.parametrize("end", [b"PK\x06\x07" + bytes(16), b""])
def test_an_archive_with_a_second_directory_or_a_comment_is_refused(end):
    data = archive()
    at = data.rindex(b"PK\x05\x06")
    comment = b"" if end else struct.pack("<H", 3) + b"abc"
    other = data[:at] + end + data[at:] if end else data[:-2] + comment
    assert refusal(other).startswith("map.npz: not a map that was saved here and can be read (")


def test_an_encrypted_member_is_refused():
    data = bytearray(archive())
    for signature, flags in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        at = data.index(signature)
        data[at + flags] |= 1
    assert "encrypted" in refusal(bytes(data))


def test_a_member_that_was_changed_is_refused():
    data = archive(method=zipfile.ZIP_STORED)
    at = data.index(CELLS.tobytes())
    assert "Bad CRC-32 for file 'log_odds.npy'" in refusal(data[:at] + b"\x01" + data[at + 1 :])
