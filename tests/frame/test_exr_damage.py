"""Whatever is in a file: our own errors with file and remedy, and never a crash."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import exr_samples
import numpy as np
import OpenEXR
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lambent.errors import DamagedFileError, DeepFileError, FileError
from lambent.frame.exr import decode, encode
from lambent.frame.exr.header import Container
from lambent.frame.files import read

DAMAGED = (
    "invalid_attribute",
    "truncated_layers",
    "truncated_scanline",
    "undecodable_pixels",
    "unopenable_header",
)


def decode_all(path: Path) -> None:
    for part in decode(path).parts:
        for channel in part.channels.values():
            assert channel.data.size > 0


@pytest.mark.parametrize("name", DAMAGED)
def test_shared_damaged_files(name: str, shared_data: Path, capfd: pytest.CaptureFixture) -> None:
    """OpenEXR's module returns an empty list for three of these, and prints; we do neither.

    Its C code says on standard error what it could not decode.
    """
    path = shared_data / "exr" / "damaged" / f"{name}.exr"
    with pytest.raises(DamagedFileError) as caught:
        decode_all(path)
    assert str(path) in str(caught.value)
    assert caught.value.remedy
    said = capfd.readouterr()
    assert said.out == ""
    assert all("EXR_ERR" in line for line in said.err.splitlines())
    assert not said.err or name == "undecodable_pixels"


def test_deep_file_is_refused(shared_data: Path) -> None:
    with pytest.raises(DeepFileError, match="deep image") as caught:
        read(shared_data / "exr" / "openexr_deep_trunks.exr")
    assert "latten" in str(caught.value)


@pytest.mark.parametrize("kind", ["scanline", "tiled", "parts"])
def test_truncation_anywhere(kind: str, tmp_path: Path) -> None:
    """A file that ends too early is found at once, wherever it ends, before any pixel is read."""
    content = exr_samples.content(
        tiled=kind == "tiled",
        parts=2 if kind == "parts" else 1,
        channels={"R": np.ones((40, 9), np.float16), "id": np.ones((40, 9), np.uint32)},
    )
    path = tmp_path / "cut.exr"
    path.write_bytes(content)
    decode_all(path)
    # Every fifth byte keeps this quick; it meets every kind of place many times.
    for end in [*range(1, len(content), 5), len(content) - 1]:
        path.write_bytes(content[:end])
        with pytest.raises(DamagedFileError):
            decode(path)


def emptied(content: bytes, rows: slice = slice(None)) -> bytes:
    """The file with zeros in (some places of) its offset tables."""
    container = Container(None, content)
    count = sum(part.chunk_count for part in container.parts)
    table = container.header_size
    offsets = np.frombuffer(content, "<u8", count, table).copy()
    offsets[rows] = 0
    return content[:table] + offsets.tobytes() + content[table + 8 * count :]


def test_a_render_that_was_stopped(tmp_path: Path) -> None:
    """An empty table, and the last rows are not there: the renderer never came to them."""
    content = exr_samples.content("ZIPS_COMPRESSION")
    end = int(Container(None, content).chunks[0].start[30])
    path = tmp_path / "stopped.exr"
    for stopped in (emptied(content)[:end], emptied(content, slice(30, None))[:end]):
        path.write_bytes(stopped)
        with pytest.raises(DamagedFileError, match=r"7 of 37 pieces .* missing"):
            decode(path)
    path.write_bytes(emptied(content)[: end + 30])
    with pytest.raises(DamagedFileError, match=r"7 of 37 pieces .* missing"):
        decode(path)


@pytest.mark.parametrize("kind", ["scanline", "decreasing", "tiled", "parts"])
def test_a_table_that_is_empty_or_wrong_is_made_anew(kind: str, tmp_path: Path) -> None:
    """All chunks are there: the same pixels, told, and written back with a table."""
    content = exr_samples.content(
        "ZIPS_COMPRESSION",
        tiled=kind in ("tiled", "parts"),
        parts=3 if kind == "parts" else 1,
        extra={"lineOrder": OpenEXR.DECREASING_Y} if kind == "decreasing" else None,
    )
    path, table = tmp_path / "in.exr", Container(None, content).header_size
    path.write_bytes(content)
    wanted = decode(path)
    assert not read(path).notes
    swapped = bytearray(content)
    swapped[table : table + 16] = content[table + 8 : table + 16] + content[table : table + 8]
    beyond = bytearray(content)
    beyond[table + 7] = 0x7F
    for broken in (emptied(content), emptied(content, slice(3, 9)), bytes(swapped), bytes(beyond)):
        path.write_bytes(broken)
        exr = decode(path)
        for part, one in zip(wanted.parts, exr.parts, strict=True):
            for name, channel in part.channels.items():
                assert one.channels[name].data.tobytes() == channel.data.tobytes()
        assert "pieces of the picture, which are all there" in " ".join(read(path).notes)
        new = {(0, "R"): exr.parts[0].channels["R"].data + 1}
        for replaced in ({}, new):
            encode(tmp_path / "out.exr", exr, replaced, overwrite=True)
            back = decode(tmp_path / "out.exr")
            assert not back.container.rebuilt
            assert back.parts[0].channels["G"].data.tobytes() == (
                wanted.parts[0].channels["G"].data.tobytes()
            )


def test_a_table_with_holes_in_a_file_with_gaps(tmp_path: Path) -> None:
    """Bytes of nobody between two chunks: what lies before and the table's own are enough."""
    content = exr_samples.content("ZIPS_COMPRESSION")
    container = Container(None, content)
    start, table = container.chunks[0].start, container.header_size
    moved = start + np.where(np.arange(37) >= 20, 5, 0)
    for empty, sound in ((slice(3, 9), True), (slice(22, 25), False)):
        offsets = moved.copy()
        offsets[empty] = 0
        body = content[table + 8 * 37 : start[20]] + b"?????" + content[start[20] :]
        path = tmp_path / "gap.exr"
        path.write_bytes(content[:table] + offsets.astype("<u8").tobytes() + body)
        if sound:
            assert decode(path).container.chunks[0].start.tolist() == moved.tolist()
        else:
            with pytest.raises(DamagedFileError, match="3 of 37 pieces"):
                decode(path)


def damaged(compression: str, seed: int = 0, tiled: bool = False) -> bytes:
    """A file whose first chunk has some bytes changed, among them those it begins with."""
    content = bytearray(exr_samples.content(compression, tiled=tiled))
    chunks = Container(None, bytes(content)).chunks[0]
    start, size = int(chunks.start[0]) + chunks.lead, int(chunks.size[0])
    rng = np.random.default_rng(seed)
    for at in rng.integers(0, min(size, 200), 5):
        content[start + at] = rng.integers(0, 256)
    content[start : start + 2] = b"\xff\xff" if seed == 0 else content[start : start + 2]
    return bytes(content)


def test_undecodable_pixels_tell_what_openexr_said(
    tmp_path: Path, capfd: pytest.CaptureFixture
) -> None:
    """The C library's words are in our message, and nothing is in the standard output."""
    path = tmp_path / "bad.exr"
    path.write_bytes(damaged("ZIP_COMPRESSION"))
    before = sys.stdout, sys.stderr
    with pytest.raises(DamagedFileError, match="EXR_ERR_CORRUPT_CHUNK") as caught:
        decode_all(path)
    assert str(path) in str(caught.value)
    assert "/proc" not in str(caught.value)
    assert (sys.stdout, sys.stderr) == before
    assert capfd.readouterr().out == ""


READ_EACH = """
import sys
from pathlib import Path
from lambent.errors import DamagedFileError
from lambent.frame.exr import decode, encode
from lambent.frame.exr.header import Container
for path in sorted(Path(sys.argv[1]).glob("*.exr")):
    try:
        for part in decode(path).parts:
            [channel.data for channel in part.channels.values()]
    except DamagedFileError as error:
        print(path.stem, "refused", "cannot be decoded" in str(error))
    else:
        print(path.stem, "read")
"""


def test_standard_output_belongs_to_the_caller(tmp_path: Path) -> None:
    """Damage in every compression: whatever C code prints, our standard output holds our lines."""
    names = []
    for compression in exr_samples.COMPRESSIONS:
        for seed in range(4 if "J2K" in compression else 1):
            for tiled in (False, True):
                names.append(f"{compression}-{seed}-{tiled}")
                path = tmp_path / f"{names[-1]}.exr"
                path.write_bytes(damaged(compression, seed, tiled))
    done = run_python(READ_EACH, tmp_path)
    assert done.returncode == 0, done.stderr
    lines = [line.split(" ", 1) for line in done.stdout.splitlines()]
    assert [name for name, _ in lines] == sorted(names)
    assert {words for _, words in lines} == {"read", "refused True"}
    assert sum(words == "refused True" for _, words in lines) > 10


@pytest.mark.parametrize("compression", ["ZIP_COMPRESSION", "HTJ2K32_COMPRESSION"])
def test_json_of_a_damaged_file_is_json(compression: str, tmp_path: Path) -> None:
    """A damaged file in `inspect --json`: an error and no word on standard output but JSON."""
    path = tmp_path / "bad.exr"
    path.write_bytes(damaged(compression))
    done = subprocess.run(
        [sys.executable, "-m", "lambent", "inspect", str(path), "--json"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "cannot be decoded" in done.stdout + done.stderr
    if done.stdout:
        json.loads(done.stdout)


def run_python(code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """A program in a process of its own, where a crash is an exit code."""
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
    )


PRINT_BESIDE = """
import sys, threading
import lambent
from lambent.errors import DamagedFileError
done = threading.Event()
lines = 0

def chatter():
    global lines
    while not done.is_set() or lines < 1000:
        print("line", lines)
        lines += 1

def read():
    for _ in range(150):
        lambent.read(sys.argv[1]).colour
    try:
        lambent.read(sys.argv[2]).colour
    except DamagedFileError:
        return
    raise SystemError("a damaged file was read")

talk = threading.Thread(target=chatter)
readers = [threading.Thread(target=read) for _ in range(3)]
for thread in (talk, *readers):
    thread.start()
for thread in readers:
    thread.join()
done.set()
talk.join()
print("lines", lines)
"""


def test_printing_beside_reading(tmp_path: Path) -> None:
    """Several threads read, sound files and damaged ones, while another prints: all lines whole."""
    for name, content in (
        ("sound", exr_samples.content("ZIP_COMPRESSION")),
        ("damaged", damaged("ZIP_COMPRESSION")),
    ):
        (tmp_path / f"{name}.exr").write_bytes(content)
    for _ in range(3):
        done = run_python(PRINT_BESIDE, tmp_path / "sound.exr", tmp_path / "damaged.exr")
        assert done.returncode == 0, done.stderr[-2000:]
        assert "Error" not in done.stderr
        *lines, last = done.stdout.splitlines()
        assert last == f"lines {len(lines)}"
        assert lines == [f"line {n}" for n in range(len(lines))]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"\x89PNG\r\n\x1a\n" + bytes(40), "PNG"),
        (b"hello, this is a text", "text file"),
        (b"\x00\x01\x02\x03" * 9, "not an EXR"),
        (b"\x76\x2f\x31\x01\x09\0\0\0" + bytes(40), "version 9"),
    ],
)
def test_what_is_no_exr(content: bytes, words: str, tmp_path: Path) -> None:
    path = tmp_path / "picture.exr"
    path.write_bytes(content)
    with pytest.raises(FileError, match=words) as caught:
        decode(path)
    assert str(path) in str(caught.value)


def test_missing_file_and_folder(tmp_path: Path) -> None:
    (tmp_path / "shot.exr").write_bytes(b"")
    with pytest.raises(FileError, match=r"no such file(.|\n)*shot\.exr"):
        decode(tmp_path / "shto.exr")
    with pytest.raises(FileError, match="directory"):
        decode(tmp_path)


def test_file_that_shrinks_after_it_was_opened(tmp_path: Path) -> None:
    """Another program writes into the file while we hold it: an error, no crash (no mmap)."""
    path = tmp_path / "in.exr"
    path.write_bytes(exr_samples.content())
    exr = decode(path)
    os.truncate(path, 600)
    with pytest.raises(DamagedFileError):
        _ = exr.parts[0].channels["R"].data


def test_nonsense_sizes_are_refused_before_memory_is_asked_for(tmp_path: Path) -> None:
    """A window of a billion by a billion pixels in a file of two kilobytes."""
    content = exr_samples.content("NO_COMPRESSION")
    box = struct.pack("<4i", 0, 0, exr_samples.WIDTH - 1, exr_samples.HEIGHT - 1)
    path = tmp_path / "huge.exr"
    for x, y in ((2**29, 2**29), (2**31 - 1, 5), (100, 2**30 - 1), (-1, 5)):
        path.write_bytes(content.replace(box, struct.pack("<4i", 0, 0, x, y), 1))
        with pytest.raises(DamagedFileError):
            decode(path)


def test_a_declared_size_beyond_what_the_file_can_hold(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """40000x40000 pixels in a small file: refused before anything is decoded; one may allow it."""
    content = exr_samples.content("ZIP_COMPRESSION")
    box = struct.pack("<4i", 0, 0, exr_samples.WIDTH - 1, exr_samples.HEIGHT - 1)
    path = tmp_path / "huge.exr"
    large = content.replace(box, struct.pack("<4i", 0, 0, 39999, 39999), 1)
    path.write_bytes(large + bytes(9999))
    with pytest.raises(FileError, match="declares 40000x40000 pixels") as caught:
        decode(path)
    assert "LAMBENT_MAX_DECODED=24G" in caught.value.remedy
    monkeypatch.setenv("LAMBENT_MAX_DECODED", "24G")
    with pytest.raises(DamagedFileError, match="of 2500 pieces"):
        decode(path)
    monkeypatch.setenv("LAMBENT_MAX_DECODED", "10K")
    path.write_bytes(content)
    with pytest.raises(FileError, match="declares 29x37 pixels"):
        decode(path)


WITHIN_4_GB = """
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))
from lambent.frame.exr import decode, encode
for path in sys.argv[1:]:
    exr = decode(path)
    new = {(0, name): channel.data + 1 for name, channel in exr.parts[0].channels.items()}
    encode(path + ".out", exr, new)
    back = decode(path + ".out")
    for name, channel in back.parts[0].channels.items():
        assert (channel.data == new[0, name]).all()
    assert back.container.parts[0].tiles == exr.container.parts[0].tiles
"""


@pytest.mark.skipif(sys.platform != "linux", reason="a limit on the memory of a process")
def test_tiles_larger_than_the_picture_take_no_memory(tmp_path: Path) -> None:
    """A tile 130 million pixels high of a picture of 3x3: read and written as small as it is."""
    paths = []
    pixels = {"R": np.ones((3, 3), np.float16), "Z": np.ones((3, 3), np.float32)}
    for compression in ("ZIP", "DWAA", "PIZ", "B44"):
        content = exr_samples.content(f"{compression}_COMPRESSION", tiled=True, channels=pixels)
        for width, height in ((16, 130_000_000), (130_000_000, 8), (2**29, 2**29)):
            paths.append(tmp_path / f"{compression}{width}x{height}.exr")
            tiles = struct.pack("<IIB", width, height, 0)
            paths[-1].write_bytes(content.replace(struct.pack("<IIB", 16, 8, 0), tiles))
    done = run_python(WITHIN_4_GB, *paths)
    assert done.returncode == 0, done.stderr


# ---------------------------------------------------------------------- fuzz


class Worker:
    """A reading process; a crash of it is a failed test, not a dead test run."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "fuzz.exr"
        self.process = subprocess.Popen(
            [sys.executable, str(Path(__file__).parent / "exr_worker.py")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            bufsize=1,
        )

    def ask(self, content: bytes) -> str:
        self.path.write_bytes(content)
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps({"path": str(self.path)}) + "\n")
        answer = self.process.stdout.readline().strip()
        assert answer, f"the reader crashed with {self.process.wait()}"
        assert answer == "ok" or answer.startswith("refused: "), answer
        return answer


@pytest.fixture(scope="module")
def worker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Worker]:
    worker = Worker(tmp_path_factory.mktemp("fuzz"))
    yield worker
    assert worker.process.stdin is not None
    worker.process.stdin.close()
    assert worker.process.wait(10) == 0


SEEDS = [
    exr_samples.content(compression, tiled=tiled, parts=parts)
    for compression in exr_samples.COMPRESSIONS
    for tiled, parts in ((False, 1), (True, 2))
]
FUZZ = settings(
    max_examples=200, deadline=None, suppress_health_check=list(HealthCheck), database=None
)
change = st.tuples(
    st.floats(0, 1, exclude_max=True),
    st.sampled_from(["set", "cut", "add", "word"]),
    st.integers(0, 255),
)


@FUZZ
@given(
    seed=st.sampled_from(SEEDS),
    changes=st.lists(change, min_size=1, max_size=5),
    reach=st.sampled_from([8, 420, 900, None]),
)
def test_fuzz_bytes(
    worker: Worker, seed: bytes, changes: list[tuple[float, str, int]], reach: int | None
) -> None:
    """Bytes changed, cut out, put in, in the header or anywhere: read, or refused by us."""
    content = bytearray(seed)
    for where, what, value in changes:
        at = int(where * min(reach or len(content), len(content)))
        if what == "set":
            content[at] = value
        elif what == "cut":
            del content[at]
        elif what == "add":
            content.insert(at, value)
        else:
            content[at : at + 4] = struct.pack("<i", (-1, 2**31 - 1, 0, -(2**31))[value % 4])
    worker.ask(bytes(content))


channel = st.tuples(
    st.binary(min_size=0, max_size=12),
    st.integers(-1, 4),
    st.sampled_from([1, 1, 1, 1, 2, 0, -1, 3, 2**31 - 1]),
    st.sampled_from([1, 1, 1, 1, 2, 0, -3]),
)
corner = st.one_of(st.integers(-70, 70), st.integers(-(2**31), 2**31 - 1))


@FUZZ
@given(
    channels=st.lists(channel, max_size=5),
    window=st.tuples(corner, corner, corner, corner),
    compression=st.integers(0, 14),
    flags=st.sampled_from([0, 0, 0x200, 0x400, 0x800, 0x1000]),
    tiles=st.tuples(st.integers(0, 40), st.integers(0, 40), st.integers(0, 40)),
    in_order=st.booleans(),
    rest=st.binary(max_size=200),
)
def test_fuzz_headers(
    worker: Worker,
    channels: list[tuple[bytes, int, int, int]],
    window: tuple[int, int, int, int],
    compression: int,
    flags: int,
    tiles: tuple[int, int, int],
    in_order: bool,
    rest: bytes,
) -> None:
    """Headers put together at random: names, types, samplings, windows, tiles, levels."""
    if in_order:
        channels = sorted({c[0].replace(b"\0", b"") or b"x": c for c in channels}.items())
        channels = [(name, *c[1:]) for name, c in channels]
        x0, y0, x1, y1 = window
        window = min(x0, x1), min(y0, y1), max(x0, x1), max(y0, y1)
    listed = b"".join(
        name + struct.pack("<xiB3xii", kind, 0, x, y) for name, kind, x, y in channels
    )
    box = struct.pack("<4i", *window)
    entries = [
        (b"channels", b"chlist", listed + b"\0"),
        (b"compression", b"compression", bytes([compression])),
        (b"dataWindow", b"box2i", box),
        (b"displayWindow", b"box2i", box),
        (b"lineOrder", b"lineOrder", b"\0"),
        (b"pixelAspectRatio", b"float", struct.pack("<f", 1)),
        (b"screenWindowCenter", b"v2f", bytes(8)),
        (b"screenWindowWidth", b"float", struct.pack("<f", 1)),
        (b"tiles", b"tiledesc", struct.pack("<IIB", *tiles)),
    ]
    header = b"".join(
        name + b"\0" + kind + b"\0" + struct.pack("<i", len(value)) + value
        for name, kind, value in entries
    )
    worker.ask(b"\x76\x2f\x31\x01" + struct.pack("<I", 2 | flags) + header + b"\0" + rest)


names = st.text(st.characters(blacklist_characters="\0", blacklist_categories=["Cs"]), min_size=1,
                max_size=20)  # fmt: skip


@settings(FUZZ, max_examples=100)
@given(
    named=st.dictionaries(names, st.sampled_from(["e", "f", "I"]), min_size=1, max_size=6),
    origin=st.tuples(st.integers(-2000, 2000), st.integers(-2000, 2000)),
    size=st.tuples(st.integers(1, 40), st.integers(1, 40)),
    compression=st.sampled_from(exr_samples.COMPRESSIONS),
    tiled=st.booleans(),
)
def test_fuzz_sound_files(
    worker: Worker,
    named: dict[str, str],
    origin: tuple[int, int],
    size: tuple[int, int],
    compression: str,
    tiled: bool,
) -> None:
    """Sound files with any names, types and windows, one-pixel ones too: always read."""
    rng = np.random.default_rng(0)
    pixels = {n: (rng.random(size) * 99).astype(kind) for n, kind in named.items()}
    if any(len(n.encode()) > 255 for n in named):
        return
    content = exr_samples.content(compression, tiled=tiled, channels=pixels, origin=origin)
    assert worker.ask(content).startswith(("ok", "refused: LayerError"))


def test_a_head_alone_ends_too_early(tmp_path: Path) -> None:
    whole = Path(__file__).parent.parent / "data" / "cycles_50_multilayer.exr"
    head = tmp_path / "head.exr"
    for length in (100, 200, 400, 800):
        head.write_bytes(whole.read_bytes()[:length])
        with pytest.raises(DamagedFileError, match="ends in the middle of its header"):
            decode(head)
