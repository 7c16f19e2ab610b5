"""What OpenVINO compiled lies on disk: taken from there if sound, made anew if not."""

import subprocess
import sys
import textwrap

import numpy as np

SCRIPT = """
    import sys, numpy as np, lambent
    image = np.random.default_rng(0).random((40, 40, 3), np.float32)
    np.save(sys.argv[1], lambent.denoise(image, "dncnn").colour)
"""


def run(cache, out):
    import os

    subprocess.run(
        [sys.executable, "-c", textwrap.dedent(SCRIPT), str(out)],
        env={**os.environ, "LAMBENT_CACHE": str(cache)}, check=True, timeout=120,
    )  # fmt: skip
    return np.load(out)


def test_a_damaged_blob_gives_the_same_picture(tmp_path):
    cache, out = tmp_path / "cache", tmp_path / "out.npy"
    first = run(cache, out)
    (blob,) = (cache / "compiled").iterdir()
    sound = blob.read_bytes()
    np.testing.assert_array_equal(run(cache, out), first)
    assert blob.read_bytes() == sound
    damaged = bytearray(sound)
    damaged[len(damaged) // 2] ^= 0x40
    for content in (damaged, sound[: len(sound) // 2], b"", b"nothing of ours"):
        blob.write_bytes(content)
        np.testing.assert_array_equal(run(cache, out), first)
        assert blob.read_bytes()[:32] == sound[:32] or len(blob.read_bytes()) > 1000
        assert [p.name for p in (cache / "compiled").iterdir()] == [blob.name]
