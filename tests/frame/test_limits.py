"""What a file declares is compared with what it may take."""

from __future__ import annotations

import pytest

from lambent.errors import FileError, OptionError
from lambent.frame import limits


def test_a_short_file_may_take_the_default_and_no_more():
    limits.check_bytes(limits.DEFAULT, "a.exr", what="a picture", stored=400)
    with pytest.raises(FileError, match=r"a\.exr: declares 130000000x1 pixels") as caught:
        limits.check_declared(130_000_000, 1, 4, 8, "a.exr", stored=400)
    assert "LAMBENT_MAX_DECODED=4G" in str(caught.value)


def test_a_long_file_may_take_a_hundred_times_its_length():
    limits.check_bytes(10**10, "a.exr", what="a picture", stored=10**8)
    with pytest.raises(FileError):
        limits.check_bytes(10**10 + 1, "a.exr", what="a picture", stored=10**8)


@pytest.mark.parametrize(
    ("text", "size"),
    [("1000", 1000), ("2k", 2048), ("1.5M", 1572864), ("4GiB", 4 * 2**30), ("1T", 2**40)],
)
def test_the_variable_replaces_the_limits(monkeypatch, text, size):
    monkeypatch.setenv(limits.VARIABLE, text)
    assert limits.allowed(10**12) == size


@pytest.mark.parametrize("text", ["much", "-1", "4X", "1e9"])
def test_the_variable_must_be_a_size(monkeypatch, text):
    monkeypatch.setenv(limits.VARIABLE, text)
    with pytest.raises(OptionError, match="is not a size"):
        limits.allowed()


def test_the_remedy_of_the_message_suffices(monkeypatch):
    for declared in (5 * 2**30 + 1, 3 * 2**20 + 1):
        with pytest.raises(FileError) as caught:
            limits.check_bytes(declared, "a", what="a picture", limit=1000)
        monkeypatch.setenv(limits.VARIABLE, str(caught.value).rpartition("=")[2])
        limits.check_bytes(declared, "a", what="a picture")
