"""What is not replaced comes back bit for bit: every shared file, every kind of file there is."""

from __future__ import annotations

import itertools
import os
import struct
from pathlib import Path

import exr_samples
import numpy as np
import OpenEXR
import pytest

from lambent.errors import LambentError, LayerError, OutputError
from lambent.frame.exr import ExrFile, decode, encode
from lambent.frame.exr import pixels as exrpixels
from lambent.frame.exr import whole as exrwhole
from lambent.frame.exr import write as exrwrite
from lambent.frame.exr.header import coordinates
from lambent.frame.exr.pixels import decode_rows
from lambent.frame.exr.whole import read_whole
from lambent.frame.exr.write import shrink, to_type

SHARED = (
    "arnold_id_multipart",
    "arnold_multichannel_tiled",
    "arnold_three_cryptomattes_tiled",
    "cycles_box_4096spp",
    "gaffer_weird_part_names",
    "mitsuba3_aov_cornell",
    "nuke_multiview_singlepart",
    "openexr_beachball_multipart_stereo",
    "openexr_beachball_singlepart_stereo",
    "openexr_displaywindow_t08",
    "openexr_luminance_chroma_rec709",
    "openexr_mipmap_colorcodedlevels",
    "openexr_nan_inf",
    "vray_cornell_layers_cryptomatte",
)
#: Files that had to be packed differently, so that compression and chunk count differ.
REPACKED = {"openexr_luminance_chroma_rec709"}


def all_levels(exr: ExrFile) -> dict[tuple[int, int, int, str], bytes]:
    """Every channel of every level of every part, as bytes."""
    found = {}
    for part in exr.container.parts:
        for level in part.levels:
            pixels = decode_rows(exr.container, part, None, level)
            for name, array in pixels.items():
                found[part.index, level.lx, level.ly, name] = array.tobytes()
    return found


def pattern(array: np.ndarray) -> np.ndarray:
    """Other pixels of the same type, exact in all of them."""
    return (np.arange(array.size).reshape(array.shape) % 500).astype(array.dtype)


def assert_same_but(before: ExrFile, after: ExrFile, changed: set[tuple[int, str]]) -> None:
    old, new = all_levels(before), all_levels(after)
    assert list(old) == list(new)
    different = {(key[0], key[3]) for key in old if old[key] != new[key]}
    assert different <= changed


def assert_same_headers(before: ExrFile, after: ExrFile, repacked: bool = False) -> None:
    assert len(before.parts) == len(after.parts)
    for old, new in zip(before.container.parts, after.container.parts, strict=True):
        if not repacked:
            assert old.raw == new.raw
        else:
            skip = {"compression", "chunkCount"}
            assert [(a.name, a.kind) for a in old.attributes] == [
                (a.name, a.kind) for a in new.attributes
            ]
            assert [a.raw for a in old.attributes if a.name not in skip] == [
                a.raw for a in new.attributes if a.name not in skip
            ]


@pytest.mark.parametrize("name", SHARED)
def test_shared_file_comes_back(name: str, shared_data: Path, tmp_path: Path) -> None:
    """One channel replaced in one part: all else, all levels, all header bytes as they were.

    Twin: OpenEXR's own module, which reads the file before and after.
    """
    source = shared_data / "exr" / f"{name}.exr"
    exr, twin = decode(source), exr_samples.bare(source)
    index = len(exr.parts) - 1
    channel = next(iter(exr.parts[index].channels.values()))
    new = pattern(channel.data)
    encode(tmp_path / "out.exr", exr, {(index, channel.name): new})
    back, after = decode(tmp_path / "out.exr"), exr_samples.bare(tmp_path / "out.exr")
    assert_same_headers(exr, back, name in REPACKED)
    assert [list(p) for p in twin] == [list(p.channels) for p in exr.parts]
    for part, before, then in zip(exr.parts, twin, after, strict=True):
        for key, pixels in before.items():
            assert part.channels[key].data.tobytes() == pixels.tobytes()
            expected = new if (part.index, key) == (index, channel.name) else pixels
            assert then[key].dtype == pixels.dtype
            assert then[key].tobytes() == expected.tobytes()
    if any(len(p.levels) > 1 for p in exr.container.parts):
        assert_same_but(exr, back, {(index, channel.name)})


@pytest.mark.parametrize("name", SHARED)
def test_shared_file_unchanged_is_the_same_file(
    name: str, shared_data: Path, tmp_path: Path
) -> None:
    """Nothing replaced: not a byte differs."""
    source = shared_data / "exr" / f"{name}.exr"
    assert encode(tmp_path / "out.exr", decode(source)) == ()
    assert (tmp_path / "out.exr").read_bytes() == source.read_bytes()


@pytest.mark.parametrize("storage", ["scanline", "tiled", "parts", "tiled parts"])
@pytest.mark.parametrize("compression", exr_samples.COMPRESSIONS)
def test_every_compression_type_and_storage(compression: str, storage: str, tmp_path: Path) -> None:
    """Half, float and uint together, in all compressions: the untouched stay bit for bit."""
    (tmp_path / "in.exr").write_bytes(
        exr_samples.content(
            compression,
            tiled="tiled" in storage,
            parts=2 if "parts" in storage else 1,
            origin=(-7, 11),
        )
    )
    exr = decode(tmp_path / "in.exr")
    last = exr.parts[-1]
    for channel in ("R", "depth.Z"):
        new = pattern(last.channels[channel].data)
        notes = encode(tmp_path / "out.exr", exr, {(last.index, channel): new}, overwrite=True)
        back = decode(tmp_path / "out.exr")
        assert_same_but(exr, back, {(last.index, channel)})
        repacked = back.parts[-1].compression != last.compression
        assert_same_headers(exr, back, repacked)
        assert repacked == bool(notes)
        if last.compression != "pxr24" or channel != "depth.Z":
            got = back.parts[-1].channels[channel].data
            lossless = repacked or last.compression not in ("b44", "b44a", "dwaa", "dwab")
            assert got.tobytes() == new.tobytes() or not lossless
        exr_samples.bare(tmp_path / "out.exr")


def test_lossy_part_is_repacked_only_where_needed(tmp_path: Path) -> None:
    """DWAA changes the others each time: ZIP then, with a note. PXR24 does not: it stays."""
    for compression, expected in (("DWAA_COMPRESSION", "zip"), ("PXR24_COMPRESSION", "pxr24")):
        (tmp_path / "in.exr").write_bytes(exr_samples.content(compression, parts=2))
        exr = decode(tmp_path / "in.exr")
        notes = encode(
            tmp_path / "out.exr", exr, {(0, "id"): exr.parts[0].channels["id"].data + 1}, True
        )
        back = decode(tmp_path / "out.exr")
        assert back.parts[0].compression == expected
        assert any("ZIP" in note for note in notes) == (expected == "zip")
        assert back.parts[1].compression == exr.parts[1].compression


def mipmapped(
    mode: int,
    round_up: bool,
    tmp_path: Path,
    compression: str = "ZIP_COMPRESSION",
    order: str = "INCREASING_Y",
) -> ExrFile:
    """A mip- or rip-mapped file: OpenEXR's module cannot write one, so ours is turned into one.

    Level by level as single-level tiles from the module, put together here by the format's rules.
    The finest level is the same all over, which any compression keeps; the others are noise.
    """
    height, width, size = 21, 38, 8
    rng = np.random.default_rng(5)

    def log(n: int) -> int:
        return (n - 1).bit_length() if round_up else n.bit_length() - 1

    def at(n: int, level: int) -> int:
        return max(1, -(-n // 2**level) if round_up else n // 2**level)

    if mode == 1:
        numbers = [(n, n) for n in range(log(max(height, width)) + 1)]
    else:
        numbers = [(x, y) for y in range(log(height) + 1) for x in range(log(width) + 1)]
    head, chunks = b"", []
    for lx, ly in numbers:
        shape = at(height, ly), at(width, lx)
        tiles = OpenEXR.TileDescription()
        tiles.xSize = tiles.ySize = size
        noise = np.ones(shape) if (lx, ly) == (0, 0) else rng.random(shape)
        pixels = {
            "Z": noise.astype(np.float32),
            "id": rng.integers(0, 99, shape, dtype=np.uint32),
            "H": np.exp(9 * noise).astype(np.float16),
            "P": OpenEXR.Channel("P", np.exp(9 * noise).astype(np.float16), 1, 1, True),
        }
        header = {"type": OpenEXR.tiledimage, "tiles": tiles,
                  "lineOrder": OpenEXR.LineOrder.__members__[order],
                  "compression": OpenEXR.Compression.__members__[compression]}  # fmt: skip
        OpenEXR.File(header, pixels).write(str(tmp_path / "level.exr"))
        one = decode(tmp_path / "level.exr").container
        raw = (tmp_path / "level.exr").read_bytes()
        if not head:
            found = one.parts[0].find("tiles")
            head = bytearray(raw[: 8 + len(one.parts[0].raw)])
            head[8 + found.at + 8] = mode | (16 if round_up else 0)
        for start, length in zip(one.chunks[0].start, one.chunks[0].size, strict=True):
            chunk = bytearray(raw[start : start + 20 + length])
            chunk[8:16] = struct.pack("<2i", lx, ly)
            chunks.append(bytes(chunk))
    place, table = len(head) + 8 * len(chunks), []
    for chunk in chunks:
        table.append(place)
        place += len(chunk)
    content = bytes(head) + struct.pack(f"<{len(table)}Q", *table) + b"".join(chunks)
    (tmp_path / "levels.exr").write_bytes(content)
    return decode(tmp_path / "levels.exr")


@pytest.mark.parametrize("round_up", [False, True])
@pytest.mark.parametrize("mode", [1, 2])
def test_levels_survive(mode: int, round_up: bool, tmp_path: Path) -> None:
    """Mip- and rip-maps: all levels of untouched channels as they were, the others made anew."""
    exr = mipmapped(mode, round_up, tmp_path)
    assert OpenEXR.File(str(tmp_path / "levels.exr"), separate_channels=True).parts
    new = np.full((21, 38), 7.0, np.float32)
    notes = encode(tmp_path / "out.exr", exr, {(0, "Z"): new})
    back = decode(tmp_path / "out.exr")
    assert_same_headers(exr, back)
    assert_same_but(exr, back, {(0, "Z")})
    assert "levels" in notes[0]
    for level in back.container.parts[0].levels:
        pixels = decode_rows(back.container, back.container.parts[0], None, level)["Z"]
        assert pixels.shape == (level.height, level.width)
        assert (pixels == 7).all()  # a grey picture stays grey on every level


@pytest.mark.parametrize("mode", [1, 2])
@pytest.mark.parametrize("compression", ["PXR24", "B44", "B44A", "DWAA", "DWAB"])
def test_lossy_levels_survive(compression: str, mode: int, tmp_path: Path) -> None:
    """A compression that keeps others at the finest level may change them at smaller ones: no.

    Chunks of a few pixels are not packed at all, so they held all bits, in B44A until a channel
    becomes flat. B44 takes logarithms of channels marked so ("P"), others it changes only once.
    """
    exr = mipmapped(mode, False, tmp_path, f"{compression}_COMPRESSION")
    for name, value in itertools.product(("Z", "H", "P", "id"), (None, 1)):
        old = exr.parts[0].channels[name].data
        new = pattern(old) if value is None else np.full_like(old, value)
        notes = encode(tmp_path / "out.exr", exr, {(0, name): new}, True)
        back = decode(tmp_path / "out.exr")
        assert_same_but(exr, back, {(0, name)})
        kept = back.parts[0].compression == compression.lower()
        assert any("packed with ZIP" in note for note in notes) != kept
        assert_same_headers(exr, back, repacked=not kept)
    if compression == "PXR24":
        encode(tmp_path / "out.exr", exr, {(0, "Z"): np.ones((21, 38), np.float32)}, True)
        assert decode(tmp_path / "out.exr").parts[0].compression == "pxr24"


def test_shrink_is_the_mean() -> None:
    """Known answer, even and odd sizes; ids are picked, never mixed."""
    image = np.arange(12, dtype=np.float32).reshape(2, 6)
    np.testing.assert_array_equal(shrink(image, 1, 3), [[3.5, 5.5, 7.5]])
    odd = shrink(np.array([[1, 2, 3, 4, 6]], np.float32), 1, 2)
    np.testing.assert_allclose(odd, [[1.5, 13 / 3]])
    ids = shrink(np.array([[7, 9]], np.uint32), 1, 1)
    assert ids.dtype == np.uint32
    assert ids[0, 0] == 7


def test_opaque_attributes_and_their_order_survive(tmp_path: Path) -> None:
    """An attribute of an unknown type, first in the header, which the module would drop."""
    (tmp_path / "in.exr").write_bytes(exr_samples.opaque_attribute(exr_samples.content()))
    exr = decode(tmp_path / "in.exr")
    assert exr.parts[0].header["secret"] == b"\0\1\2\3\4"
    encode(tmp_path / "out.exr", exr, {(0, "R"): exr.parts[0].channels["R"].data * 2})
    back = decode(tmp_path / "out.exr")
    assert_same_headers(exr, back)
    assert back.container.parts[0].attributes[0].name == "secret"


def chunk_rows(exr: ExrFile, part: int) -> dict[tuple[int, int], list[int]]:
    """By level: the rows of chunks as they come in the file."""
    found: dict[tuple[int, int], list[int]] = {}
    header = exr.container.parts[part]
    places = coordinates(header)
    for n in np.argsort(exr.container.chunks[part].start):
        row = int(places[n][1] if header.tiles else places[n][0])
        found.setdefault(tuple(places[n][2:].tolist()), []).append(row)
    return found


@pytest.mark.parametrize("bands", [False, True])
@pytest.mark.parametrize("parts", [1, 2])
@pytest.mark.parametrize("tiled", [False, True])
@pytest.mark.parametrize("compression", ["NO_COMPRESSION", "ZIP_COMPRESSION", "DWAA_COMPRESSION"])
def test_line_order_is_kept(
    compression: str, tiled: bool, parts: int, bands: bool, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Chunks lie in decreasing y as the header says, in parts copied and packed anew."""
    content = exr_samples.content(
        compression, tiled=tiled, parts=parts, extra={"lineOrder": OpenEXR.DECREASING_Y}
    )
    (tmp_path / "in.exr").write_bytes(content)
    exr = decode(tmp_path / "in.exr")
    if bands:
        monkeypatch.setattr(exrpixels, "BAND_BYTES", 4000)
        monkeypatch.setattr(exrwrite, "write_whole", lambda *_: False)
    encode(tmp_path / "out.exr", exr, {(0, "R"): pattern(exr.parts[0].channels["R"].data)})
    back = decode(tmp_path / "out.exr")
    for part in range(parts):
        assert back.parts[part].header["lineOrder"] == "decreasing"
        for rows in chunk_rows(back, part).values():
            assert rows == sorted(rows, reverse=True)
    assert_same_but(exr, back, {(0, "R")})
    assert len(exr_samples.bare(tmp_path / "out.exr")) == parts


@pytest.mark.parametrize("mode", [1, 2])
def test_line_order_of_levels(mode: int, tmp_path: Path) -> None:
    """Within a level tiles go upwards, levels from fine to coarse: the format's rule."""
    exr = mipmapped(mode, True, tmp_path, order="DECREASING_Y")
    encode(tmp_path / "out.exr", exr, {(0, "Z"): np.ones((21, 38), np.float32)})
    back = decode(tmp_path / "out.exr")
    found = chunk_rows(back, 0)
    assert list(found) == [(level.lx, level.ly) for level in back.container.parts[0].levels]
    assert max(len(set(rows)) for rows in found.values()) > 1
    for rows in found.values():
        assert rows == sorted(rows, reverse=True)
    assert_same_but(exr, back, {(0, "Z")})


def test_channel_names_that_are_no_text(tmp_path: Path) -> None:
    """A channel named in Latin-1 bytes: it can be read, replaced, and keeps its bytes."""
    raw = exr_samples.content(channels={"caf_": np.ones((4, 5), np.float32)})
    (tmp_path / "in.exr").write_bytes(raw.replace(b"caf_\0", b"caf\xe9\0"))
    exr = decode(tmp_path / "in.exr")
    (name,) = exr.parts[0].channels
    encode(tmp_path / "out.exr", exr, {(0, name): np.full((4, 5), 3.0, np.float32)})
    assert b"caf\xe9\0" in (tmp_path / "out.exr").read_bytes()
    assert (decode(tmp_path / "out.exr").parts[0].channels[name].data == 3).all()


@pytest.mark.parametrize("compression", exr_samples.COMPRESSIONS)
def test_colours_named_in_latin_1(compression: str, tmp_path: Path) -> None:
    """Every compression, DWA too, which tells colours by what their names end in."""
    values = exr_samples.arrays()
    channels = {f"licht_{x}.{c}": values[c] for x in ("_", "~") for c in "RGB"}
    channels |= {"RGBA"[n]: values["RGBA"[n]] for n in range(4)} | {"depth.Z": values["depth.Z"]}
    content = exr_samples.content(compression, channels=channels)
    (tmp_path / "utf8.exr").write_bytes(content)
    content = content.replace(b"licht__.", b"licht_\xe4.").replace(b"licht_~.", b"licht_\xfc.")
    (tmp_path / "in.exr").write_bytes(content)
    wanted = decode(tmp_path / "utf8.exr").parts[0].channels
    exr = decode(tmp_path / "in.exr")
    got = exr.parts[0].channels
    for name, channel in wanted.items():
        raw = name.encode().replace(b"__", b"_\xe4").replace(b"_~", b"_\xfc")
        twin = got[raw.decode("utf-8", "surrogateescape")]
        assert twin.data.tobytes() == channel.data.tobytes()
    encode(tmp_path / "out.exr", exr, {(0, "R"): pattern(values["R"])})
    back = decode(tmp_path / "out.exr")
    assert_same_but(exr, back, {(0, "R")})
    new = {(0, name): channel.data for name, channel in got.items()}
    encode(tmp_path / "all.exr", exr, new)
    renamed = (tmp_path / "all.exr").read_bytes()
    renamed = renamed.replace(b"licht_\xe4.", b"licht__.").replace(b"licht_\xfc.", b"licht_~.")
    (tmp_path / "all.exr").write_bytes(renamed)
    encode(tmp_path / "twin.exr", decode(tmp_path / "utf8.exr"),
           {(0, name): channel.data for name, channel in wanted.items()})  # fmt: skip
    (again,), (twin,) = (exr_samples.bare(tmp_path / f"{n}.exr") for n in ("all", "twin"))
    assert all(again[name].tobytes() == twin[name].tobytes() for name in wanted)


def test_rows_and_fill_equal_the_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Reading in bands gives what reading at once gives, for rows, tiles, and windows anywhere."""
    from lambent.frame.exr import file as exrfile

    monkeypatch.setattr(exrfile, "KEEP_BYTES", 0)
    monkeypatch.setattr(exrpixels, "BAND_BYTES", 3000)
    for tiled in (False, True):
        for compression in ("ZIP_COMPRESSION", "NO_COMPRESSION", "ZIPS_COMPRESSION"):
            content = exr_samples.content(compression, tiled=tiled, origin=(3, -20))
            (tmp_path / "in.exr").write_bytes(content)
            whole = exr_samples.bare(tmp_path / "in.exr")[0]
            part = decode(tmp_path / "in.exr").parts[0]
            assert (part.rows(5, 23)["G"] == whole["G"][5:23]).all()
            image = np.zeros((20, 11, 2), np.float32)
            places = {"G": [(image[:, :, 0], 9, 4)], "depth.Z": [(image[:, :, 1], 9, 4)]}
            part.fill(places)
            assert (image[:, :, 0] == whole["G"][9:29, 4:15]).all()
            assert (image[:, :, 1] == whole["depth.Z"][9:29, 4:15]).all()
            assert not part.pixels.kept


def test_writing_in_bands_equals_writing_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Small bands bound the memory and change nothing."""
    from lambent.frame.exr import file as exrfile

    for tiled in (False, True):
        (tmp_path / "in.exr").write_bytes(exr_samples.content(tiled=tiled, parts=2))
        exr = decode(tmp_path / "in.exr")
        replaced = {(0, "R"): pattern(exr.parts[0].channels["R"].data)}
        encode(tmp_path / "one.exr", exr, replaced, True)
        exr = decode(tmp_path / "in.exr")
        monkeypatch.setattr(exrfile, "KEEP_BYTES", 0)
        monkeypatch.setattr(exrpixels, "BAND_BYTES", 2000)
        encode(tmp_path / "many.exr", exr, replaced, True)
        monkeypatch.undo()
        assert (tmp_path / "one.exr").read_bytes() == (tmp_path / "many.exr").read_bytes()


def test_to_type_clamps_and_keeps_what_was_infinite() -> None:
    """A half never becomes infinite; what was infinite or NaN before stays so."""
    values = np.array([1e6, -1e6, 65519.0, np.inf, -np.inf, np.nan, 0.5], np.float32)
    half = to_type(values, np.dtype(np.float16))
    np.testing.assert_array_equal(half, [65504, -65504, 65504, np.inf, -np.inf, np.nan, 0.5])
    whole = to_type(np.array([-1, 2.4, 5e9, np.nan], np.float32), np.dtype(np.uint32))
    np.testing.assert_array_equal(whole, [0, 2, 4294967295, 0])


def test_wrong_size_and_unknown_channel_are_errors(tmp_path: Path) -> None:
    (tmp_path / "in.exr").write_bytes(exr_samples.content())
    exr = decode(tmp_path / "in.exr")
    with pytest.raises(LayerError, match="29x37"):
        encode(tmp_path / "o.exr", exr, {(0, "R"): np.zeros((3, 3), np.float32)})
    with pytest.raises(LayerError, match="no channel 'Q'"):
        encode(tmp_path / "o.exr", exr, {(0, "Q"): np.zeros((37, 29), np.float32)})
    assert os.listdir(tmp_path) == ["in.exr"]


def test_reading_goes_on_after_the_file_was_replaced(tmp_path: Path) -> None:
    """Pixels come from the file that was opened, even when its name means another one by now."""
    path = tmp_path / "in.exr"
    path.write_bytes(exr_samples.content())
    exr = decode(path)
    old = exr_samples.bare(path)[0]["R"]
    encode(path, decode(path), {(0, "R"): np.zeros_like(old)}, overwrite=True)
    assert exr.parts[0].channels["R"].data.tobytes() == old.tobytes()


def test_texts_can_be_added_to_the_header(tmp_path: Path) -> None:
    """Added or replaced; names over 31 bytes need a flag, without which readers refuse the file."""
    (tmp_path / "in.exr").write_bytes(exr_samples.content())
    exr = decode(tmp_path / "in.exr")
    long_name = "an/attribute/with/a/really/long/name"
    encode(tmp_path / "a.exr", exr, {}, attributes={"note": "one", long_name: "x"})
    encode(tmp_path / "b.exr", decode(tmp_path / "a.exr"), {}, attributes={"note": "longer text"})
    header = OpenEXR.File(str(tmp_path / "b.exr")).header()
    assert header["note"] == "longer text"
    assert header[long_name] == "x"
    assert_same_but(exr, decode(tmp_path / "b.exr"), set())


def test_text_that_another_attribute_quotes(tmp_path: Path) -> None:
    """An attribute whose bytes are those of an older text's entry stays; the text is replaced."""
    old = b"stamp\0string\0" + struct.pack("<i", 3) + b"old"
    (tmp_path / "in.exr").write_bytes(exr_samples.content(extra={"note": "n" * len(old)}))
    quoting = (tmp_path / "in.exr").read_bytes().replace(b"n" * len(old), old)
    (tmp_path / "in.exr").write_bytes(quoting)
    first = decode(tmp_path / "in.exr")
    encode(tmp_path / "a.exr", first, {}, attributes={"stamp": "old"})
    for replaced in ({}, {(0, "R"): pattern(first.parts[0].channels["R"].data)}):
        exr = decode(tmp_path / "a.exr")
        encode(tmp_path / "b.exr", exr, replaced, True, attributes={"stamp": "a longer one"})
        back = decode(tmp_path / "b.exr")
        assert back.parts[0].header["stamp"] == "a longer one"
        assert back.container.parts[0].find("note").raw == old
        names = [a.name for a in back.container.parts[0].attributes]
        assert names == [a.name for a in exr.container.parts[0].attributes]
        assert_same_but(exr, back, {(0, "R")})


def test_existing_target_is_refused(tmp_path: Path) -> None:
    (tmp_path / "in.exr").write_bytes(exr_samples.content())
    with pytest.raises(OutputError, match="exists already") as caught:
        encode(tmp_path / "in.exr", decode(tmp_path / "in.exr"))
    assert isinstance(caught.value, LambentError)
    assert "--overwrite" in str(caught.value)


# ---------------------------------------------------------------- whole files

QUICK = [c for c in exr_samples.COMPRESSIONS if "J2K" not in c]


@pytest.mark.parametrize("parts", [1, 2])
@pytest.mark.parametrize("tiled", [False, True])
def test_whole_files_are_read_by_the_module_itself(tiled: bool, parts: int, tmp_path: Path) -> None:
    """The quick way is taken, and gives what the way in chunks gives (twin)."""
    for compression in QUICK:
        content = exr_samples.content(compression, tiled=tiled, parts=parts, origin=(-3, 5))
        (tmp_path / "in.exr").write_bytes(content)
        exr = decode(tmp_path / "in.exr")
        whole = read_whole(exr.container)
        assert whole is not None
        for part, arrays in zip(exr.container.parts, whole, strict=True):
            twin = decode_rows(exr.container, part)
            assert list(twin) == list(arrays)
            assert all(twin[name].tobytes() == arrays[name].tobytes() for name in twin)
        exr.gather(range(parts))
        assert all(part.pixels.kept for part in exr.parts) == (parts > 1)


def test_headers_the_module_may_not_see(tmp_path: Path) -> None:
    """An attribute of unknown type, or with the wrong size, and names that are no text."""
    plain = exr_samples.content(extra={"note": "text"})
    for content in (
        exr_samples.opaque_attribute(plain),
        plain.replace(b"note\0string\0\4\0\0\0text", b"note\0double\0\4\0\0\0text"),
        plain.replace(b"note\0string\0\4\0\0\0text", b"note\0string\0\4\0\0\0te\xfft"),
        plain.replace(b"depth.Z\0", b"depth\xff\xff\0"),
    ):
        assert content != plain
        (tmp_path / "in.exr").write_bytes(content)
        exr = decode(tmp_path / "in.exr")
        assert read_whole(exr.container) is None
        assert exr.parts[0].channels["R"].data.tobytes() == exr_samples.arrays()["R"].tobytes()


@pytest.mark.parametrize("tiled", [False, True])
def test_whole_files_are_written_by_the_module_itself(
    tiled: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Byte for byte the file that the way in chunks makes, for headers of several lengths."""
    went = []

    def whole(*arguments: object) -> bool:
        went.append(exrwhole.write_whole(*arguments))
        return went[-1]

    for compression in ("NO_COMPRESSION", "RLE_COMPRESSION", "ZIP_COMPRESSION", "PIZ_COMPRESSION"):
        (tmp_path / "in.exr").write_bytes(exr_samples.content(compression, tiled=tiled))
        exr = decode(tmp_path / "in.exr")
        replaced = {(0, "R"): pattern(exr.parts[0].channels["R"].data)}
        for n in (None, 0, 1, 200):
            texts = {} if n is None else {"~": "x" * n}
            for name, way in (("whole", whole), ("chunks", lambda *_: False)):
                monkeypatch.setattr(exrwrite, "write_whole", way)
                encode(tmp_path / f"{name}.exr", exr, replaced, True, texts)
            assert (tmp_path / "whole.exr").read_bytes() == (tmp_path / "chunks.exr").read_bytes()
    assert went == [True] * 16


def test_module_that_fails_while_writing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What it wrote so far, or wrote wrongly, is gone; the way in chunks makes the file."""
    (tmp_path / "in.exr").write_bytes(exr_samples.content())
    exr = decode(tmp_path / "in.exr")
    replaced = {(0, "R"): pattern(exr.parts[0].channels["R"].data)}
    encode(tmp_path / "good.exr", exr, replaced)
    checked = []
    monkeypatch.setattr(exrwhole, "_is_sound", lambda *a: bool(checked.append(a)))
    encode(tmp_path / "again.exr", exr, replaced)
    assert checked
    assert (tmp_path / "again.exr").read_bytes() == (tmp_path / "good.exr").read_bytes()


def test_pxr24_is_kept_where_it_loses_nothing(tmp_path: Path) -> None:
    """Floats of a PXR24 file survive (NaN and infinities too), unless stored unpacked."""
    floats = exr_samples.arrays()["depth.Z"]
    floats[3, :4] = np.nan, np.inf, -np.inf, -0.0
    channels = {"R": np.ones_like(floats), "depth.Z": floats}
    (tmp_path / "in.exr").write_bytes(
        exr_samples.content("PXR24_COMPRESSION", channels=dict(channels))
    )
    exr = decode(tmp_path / "in.exr")
    before = exr.parts[0].channels["depth.Z"].data
    notes = encode(tmp_path / "out.exr", exr, {(0, "R"): channels["R"] * 2})
    after = decode(tmp_path / "out.exr").parts[0]
    assert notes == ()
    assert after.compression == "pxr24"
    assert after.channels["depth.Z"].data.tobytes() == before.tobytes()
    # Noise of all bits cannot be packed, so the file holds it unpacked, with all 32 bits.
    noise = np.random.default_rng(1).integers(0, 2**31, (37, 29), np.uint32).view(np.float32)
    only = exr_samples.content("PXR24_COMPRESSION", channels={"R": noise, "Z": noise})
    (tmp_path / "noise.exr").write_bytes(only)
    exr = decode(tmp_path / "noise.exr")
    before = exr.parts[0].channels["Z"].data
    encode(tmp_path / "out2.exr", exr, {(0, "R"): np.zeros_like(noise)})
    assert decode(tmp_path / "out2.exr").parts[0].channels["Z"].data.tobytes() == before.tobytes()
