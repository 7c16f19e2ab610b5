"""PFM: both kinds, both byte orders, bottom row first, the scale; exactly there and back."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from lambent.denoise.files import denoise_file
from lambent.errors import DamagedFileError
from lambent.frame.files import read, write, write_noted
from lambent.frame.frame import Frame
from lambent.frame.role import Role


@pytest.mark.parametrize("end", ["\n", "\r\n", " "])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("channels", [1, 3])
def test_values_by_definition(channels, order, end, tmp_path):
    """Packed number by number: from the bottom row up, from the left to the right."""
    image = np.arange(2 * 3 * channels, dtype=np.float32).reshape(2, 3, channels) - 2.5
    head = f"{'PF' if channels == 3 else 'Pf'}{end}3 2{end}{-1 if order == '<' else 1}.0\n".encode()
    flat = [float(v) for row in image[::-1] for pixel in row for v in pixel]
    path = tmp_path / "a.pfm"
    path.write_bytes(head + struct.pack(f"{order}{len(flat)}f", *flat))
    frame = read(path)
    np.testing.assert_array_equal(frame[Role.COLOUR], image)
    assert frame.origin.kind == "pfm"
    assert frame.notes == ()


def test_there_and_back_is_exact(tmp_path):
    rng = np.random.default_rng(0)
    for channels in (1, 3):
        image = (rng.normal(size=(7, 5, channels)) * 1e4).astype(np.float32)
        image[0, 0] = (np.nan,) * channels
        path = write(tmp_path / f"{channels}.pfm", Frame.from_arrays(colour=image))
        np.testing.assert_array_equal(read(path)[Role.COLOUR], image)


def test_the_scale_multiplies_and_is_told(tmp_path):
    path = tmp_path / "a.pfm"
    path.write_bytes(b"Pf\n# by hand\n2 1\n-2.5\n" + struct.pack("<2f", 1, -4))
    frame = read(path)
    np.testing.assert_array_equal(frame[Role.COLOUR].ravel(), [2.5, -10])
    assert "scale, 2.5" in frame.notes[0]


def test_pfm_is_denoised_into_pfm(tmp_path):
    image = np.random.default_rng(0).gamma(2, 0.5, (16, 16, 3)).astype(np.float32)
    source = write(tmp_path / "in.pfm", Frame.from_arrays(colour=image))
    result = denoise_file(source, model="box")
    assert result.output == tmp_path / "in_clean.pfm"
    assert read(result.output).colour.std() < 0.6 * image.std()


def test_what_it_does_not_hold_is_told(tmp_path):
    colour, alpha = np.ones((4, 4, 3), np.float32), np.ones((4, 4, 1), np.float32)
    notes = write_noted(tmp_path / "a.pfm", Frame.from_arrays(colour=colour, alpha=alpha)).notes
    assert any("no alpha" in note for note in notes)


@pytest.mark.parametrize(
    ("head", "words"),
    [
        (b"PF\n3 2\n0\n", "header"),
        (b"PF\n3 2\nnan\n", "header"),
        (b"PF\n3 2\ninf\n", "header"),
        (b"PF\n3\n", "header"),
        (b"PF\n3 -2\n1\n", "header"),
        (b"PF\n0 2\n-1\n", "size"),
        (b"PF\n3 3\n-1\n", "ends before"),
    ],
)
def test_damaged(head, words, tmp_path):
    path = tmp_path / "a.pfm"
    path.write_bytes(head + bytes(3 * 2 * 3 * 4))
    with pytest.raises(DamagedFileError, match=words):
        read(path)
