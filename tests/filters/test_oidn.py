"""OIDN as a denoiser: the same pixels as the library itself, sums, tiles, grey, stopping."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading

import mitsuba_oidn
import numpy as np
import pytest

from lambent.errors import EngineError, OptionError
from lambent.filters.denoiser import create
from lambent.filters.oidn import OIDN, OIDNBalanced, OIDNBest, OIDNFast, is_grey
from lambent.frame.exposure import block_exposure
from lambent.frame.frame import Frame
from lambent.frame.layer import Layer
from lambent.frame.role import Role, Space
from lambent.kernels import oidn
from lambent.kernels.oidn import Options


def noisy(height: int = 96, width: int = 128, seed: int = 0) -> dict[str, np.ndarray]:
    """Noise over a smooth texture, with guides that show the texture."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width].astype(np.float32)
    albedo = np.stack(
        [
            0.5 + 0.4 * np.sin(x / 9),
            0.5 + 0.4 * np.cos(y / 7),
            ((x // 16 + y // 16) % 2) * 0.6 + 0.2,
        ],
        2,
    )
    light = rng.gamma(0.7, 1 / 0.7, (height, width, 1)) * (0.2 + x / width)[:, :, None]
    normal = np.stack([np.sin(x / 30), np.zeros_like(x), np.cos(x / 30)], 2)
    arrays = {"colour": albedo * light, "albedo": albedo, "normal": normal}
    return {name: array.astype(np.float32) for name, array in arrays.items()}


def direct(color, albedo=None, normal=None, **options):
    """The package's own function."""
    options.setdefault("hdr", True)
    return mitsuba_oidn.denoise(color, albedo, normal, **options)


def beauty(frame: Frame) -> np.ndarray:
    return frame[Role.COLOUR]


@pytest.mark.parametrize(
    ("model", "quality"), [(OIDN, "High"), (OIDNBalanced, "Balanced"), (OIDNFast, "Fast")]
)
def test_same_as_the_library(model, quality):
    """Adapter and library agree bit for bit: nothing is converted or scaled on the way."""
    a = noisy()
    clean = beauty(model()(Frame.from_arrays(**a)))
    expected = direct(
        a["colour"], a["albedo"], a["normal"], quality=getattr(mitsuba_oidn.Quality, quality)
    )
    np.testing.assert_array_equal(clean, expected)
    assert np.abs(clean - a["colour"]).mean() > 0.1


def test_best_prefilters_and_takes_guides_as_clean():
    """oidn-best = two prefilterings and clean_aux, called by hand."""
    a = noisy()
    guides = {}
    for name in ("albedo", "normal"):
        flt = mitsuba_oidn.Device(mitsuba_oidn.DeviceType.Default).new_filter("RT")
        flt.set_image(name, a[name])
        guides[name] = np.empty_like(a[name])
        flt.set_image("output", guides[name])
        flt.execute()
    expected = direct(a["colour"], guides["albedo"], guides["normal"], clean_aux=True)
    clean = beauty(OIDNBest()(Frame.from_arrays(**a)))
    np.testing.assert_array_equal(clean, expected)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"normal": False}, {"normal": None}),
        ({"albedo": False}, {"albedo": None, "normal": None}),
        ({"clean_aux": True}, {"clean_aux": True}),
        ({"input_scale": 0.3}, {"input_scale": 0.3}),
        ({"hdr": False}, {"hdr": False}),
        ({"hdr": False, "srgb": True}, {"hdr": False, "srgb": True}),
    ],
)
def test_every_option_reaches_the_library(options, expected):
    a = noisy(48, 64)
    call = {"albedo": a["albedo"], "normal": a["normal"], **expected}
    clean = beauty(OIDN(**options)(Frame.from_arrays(**a)))
    np.testing.assert_array_equal(clean, direct(a["colour"], **call))


def test_options_from_text():
    """The command line hands over text; a quality that does not exist is refused."""
    model = create("oidn", quality="fast", clean_aux="yes", input_scale="0.5", threads="1")
    assert model == OIDN(quality="fast", clean_aux=True, input_scale=0.5, threads=1)
    with pytest.raises(OptionError, match="balanced"):
        create("oidn", quality="ultra")
    with pytest.raises(OptionError, match="input_scale"):
        OIDN(input_scale=-1.0)


def test_one_thread_gives_the_same():
    a = noisy(48, 64)
    frame = Frame.from_arrays(**a)
    np.testing.assert_allclose(
        beauty(OIDN(threads=1)(frame)), beauty(OIDN()(frame)), rtol=1e-4, atol=1e-5
    )


def test_display_referred_colour():
    """A colour layer in sRGB goes in as LDR with that transfer."""
    a = noisy(48, 64)
    ldr = np.clip(a["colour"], 0, 1)
    frame = Frame.from_layers([Layer(Role.COLOUR, ldr, space=Space.SRGB)])
    clean = beauty(OIDN()(frame))
    np.testing.assert_array_equal(clean, direct(ldr, hdr=False, srgb=True))
    assert clean.max() <= 1


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (40, 1), (17, 33)])
def test_small_images(size):
    a = noisy(*size)
    clean = beauty(OIDN()(Frame.from_arrays(**a)))
    assert clean.shape == (*size, 3)
    assert np.isfinite(clean).all()


def test_strided_input_needs_no_copy():
    """A crop of a stack of channels gives what its contiguous copy gives."""
    a = noisy(64, 80)
    stack = np.concatenate([a["colour"], a["albedo"], a["normal"]], axis=2)[5:50, 7:71]
    images = {"color": stack[:, :, :3], "albedo": stack[:, :, 3:6], "normal": stack[:, :, 6:]}
    copies = {name: np.ascontiguousarray(image) for name, image in images.items()}
    assert oidn._readable(images["color"]) is images["color"]
    np.testing.assert_array_equal(oidn.clean(images, Options()), oidn.clean(copies, Options()))


@pytest.mark.parametrize("view", [np.s_[::-1], np.s_[:, ::-1], np.s_[:, :, ::-1]])
def test_layouts_the_library_refuses_are_copied(view):
    image = noisy(32, 40)["colour"][view]
    expected = direct(np.ascontiguousarray(image))
    np.testing.assert_array_equal(oidn.clean({"color": image}, Options()), expected)


def test_staging_for_devices_that_do_not_see_our_memory(monkeypatch):
    """The way a GPU takes, with buffers, gives the same as shared memory."""
    a = noisy(48, 64)
    images = {"color": a["colour"], "albedo": a["albedo"]}
    expected = oidn.clean(images, Options())
    real = oidn._bind

    class Blind:
        """A filter whose device cannot share memory."""

        def __init__(self, worker):
            self._worker = worker
            self.device = self

        def can_share(self, image):
            return False

        def new_buffer(self, size):
            return self._worker.device.new_buffer(size)

        def set_image(self, *args, **kinds):
            self._worker.set_image(*args, **kinds)

    monkeypatch.setattr(oidn, "_bind", lambda w, name, image: real(Blind(w), name, image))
    np.testing.assert_array_equal(oidn.clean(images, Options()), expected)


# ---------------------------------------------------------------- exposure, tiles


@pytest.mark.parametrize("size", [(100, 150), (17, 33), (1, 1), (1, 70), (64, 64)])
def test_exposure_is_the_librarys(size):
    """Our input scale gives what automatic exposure gives; one per cent off does not."""
    rng = np.random.default_rng(3)
    image = (rng.gamma(0.5, 8, (*size, 3))).astype(np.float32)
    image[: size[0] // 3] = 0  # black blocks do not count
    automatic = oidn.clean({"color": image}, Options())
    scale = block_exposure(image)
    given = oidn.clean({"color": image}, Options(input_scale=scale))
    off = oidn.clean({"color": image}, Options(input_scale=1.01 * scale))
    peak = automatic.max()
    assert np.abs(given - automatic).max() < 1e-5 * peak
    assert np.abs(off - automatic).max() > 1e-4 * peak


def test_exposure_of_nothing_is_one():
    assert block_exposure(np.zeros((20, 20, 3), np.float32)) == 1.0
    assert np.isfinite(block_exposure(np.full((20, 20, 1), np.nan, np.float32)))


@pytest.mark.parametrize("model", [OIDNFast(), OIDN(clean_aux=True)])
def test_tiles_equal_the_whole(model):
    """A tile with margin() around it, from a multiple of 16, gives the pixels of the whole."""
    a = noisy(40, 288)
    frame = Frame.from_arrays(**a, lighting={"key": a["colour"] * 0.7, "fill": a["colour"] * 0.3})
    layers = [frame.layer(Role.COLOUR), *frame.extras.values()]
    fitted = model.fitted(frame)
    # Like tiles, the whole gets its exposure from us: automatic differs in the last digits.
    whole = fitted.filter_layers(frame.replace(), layers)
    left = 160 - model.margin()
    assert left % oidn.ALIGNMENT == 0
    piece = frame.crop(0, 40, left, 288)
    cut = [layer.with_data(layer.data[:, left:]) for layer in layers]
    for tile, expected in zip(fitted.filter_layers(piece, cut), whole, strict=True):
        np.testing.assert_array_equal(tile[:, 160 - left :], expected[:, 160:])
    unfitted = model.filter_layers(piece, cut)
    assert np.abs(unfitted[0][:, 160 - left :] - whole[0][:, 160:]).max() > 1e-4


def test_margin_is_the_librarys_overlap():
    a = noisy(32, 32)
    for model, quality, clean in (
        (OIDN(), "High", False),
        (OIDNBest(), "High", True),
        (OIDNFast(), "Fast", False),
    ):
        flt = mitsuba_oidn.Device(mitsuba_oidn.DeviceType.CPU).new_filter("RT")
        flt.quality = getattr(mitsuba_oidn.Quality, quality)
        flt.hdr, flt.clean_aux = True, clean
        out = np.empty_like(a["colour"])
        for name, image in (
            ("color", a["colour"]),
            ("albedo", a["albedo"]),
            ("normal", a["normal"]),
            ("output", out),
        ):
            flt.set_image(name, image)
        flt.commit()
        assert (model.margin(), oidn.ALIGNMENT) == (flt.tile_overlap, flt.tile_alignment)


def test_a_dark_or_grey_tile_of_a_bright_colourful_frame():
    """What decides how to filter is read off the whole frame, not off the tile."""
    a = noisy(64, 352)
    a["colour"][:, :176] = a["colour"][:, :176, :1]
    frame = Frame.from_arrays(**a)
    model = OIDNFast().fitted(frame)
    layer = frame.layer(Role.COLOUR)
    whole = model.filter_layers(frame.replace(), [layer])[0]
    piece = frame.crop(0, 64, 0, 160)
    tile = model.filter_layers(piece, [layer.with_data(layer.data[:, :160])])[0]
    np.testing.assert_array_equal(tile[:, :64], whole[:, :64])
    assert is_grey(layer.data[:, :160])
    assert not is_grey(tile[:, :64])


# ------------------------------------------------------------------ grey, black, alpha


def test_grey_stays_grey():
    """Three equal channels come out equal; as the library tints them, this is our doing."""
    a = noisy()
    grey = np.repeat(a["colour"][:, :, :1], 3, axis=2)
    frame = Frame.from_arrays(colour=grey, albedo=a["albedo"])
    kept = beauty(OIDN()(frame))
    tinted = beauty(OIDN(keep_grey=False)(frame))
    assert is_grey(kept)
    assert not is_grey(tinted)
    np.testing.assert_allclose(kept[:, :, 0], tinted.mean(axis=2), rtol=1e-4, atol=1e-5)
    one = OIDN()(Frame.from_arrays(colour=grey[:, :, :1], albedo=a["albedo"]))
    assert one.layer(Role.COLOUR).data.shape == (*grey.shape[:2], 1)
    np.testing.assert_array_equal(one.layer(Role.COLOUR).data, kept[:, :, :1])


def test_is_grey_sees_a_single_coloured_pixel():
    image = np.ones((40, 50, 3), np.float32)
    assert is_grey(image)
    image[33, 21, 2] = 1.0001
    assert not is_grey(image)


def test_black_stays_black():
    """The library alone returns a faint glow."""
    black = np.zeros((40, 40, 3), np.float32)
    assert direct(black).max() > 0
    assert beauty(OIDN()(Frame.from_arrays(colour=black))).max() == 0


def test_alpha_is_filtered_as_coverage():
    a = noisy(64, 64)
    rng = np.random.default_rng(1)
    coverage = (rng.random((64, 64, 1)) < np.linspace(0, 1, 64)[None, :, None]).astype(np.float32)
    frame = Frame.from_arrays(**a, alpha=coverage)
    clean = OIDN()(frame, passes=["alpha"])[Role.ALPHA]
    expected = np.clip(direct(coverage, a["albedo"], a["normal"], input_scale=0.3), 0, 1)
    np.testing.assert_array_equal(clean, expected)
    assert clean.shape == (64, 64, 1)
    assert clean.min() >= 0
    assert clean.max() <= 1


# --------------------------------------------------------------------- layers, sums


def test_layers_sum_to_the_beauty():
    """direct + indirect, and light groups beside them; the library alone misses both."""
    a = noisy(64, 96)
    rng = np.random.default_rng(5)
    share = rng.random((64, 96, 1)).astype(np.float32)
    key, fill = a["colour"] * share, a["colour"] * (1 - share)
    half = [(a["colour"] * s).astype(np.float16).astype(np.float32) for s in (0.2, 0.5, 0.3)]
    frame = Frame.from_arrays(
        **a, direct=key, indirect=fill, lighting=dict(zip("abc", half, strict=True))
    )
    clean = OIDN()(frame)
    total = clean[Role.DIRECT] + clean[Role.INDIRECT]
    groups = sum(clean.extras[name].data for name in "abc")
    np.testing.assert_allclose(total, beauty(clean), rtol=2e-6, atol=1e-7)
    np.testing.assert_allclose(groups, beauty(clean), rtol=2e-6, atol=1e-7)
    assert min(clean[Role.DIRECT].min(), clean[Role.INDIRECT].min()) >= 0
    alone = [direct(image, a["albedo"], a["normal"]) for image in (key, fill)]
    assert np.abs(sum(alone) - beauty(clean)).max() > 1e-2
    # The share-out is a correction, not another picture.
    assert np.abs(clean[Role.DIRECT] - alone[0]).mean() < 0.1 * alone[0].mean()


def test_layers_that_do_not_sum_are_left_alone():
    a = noisy(48, 64)
    other = (a["colour"][:, ::-1] * 0.4).copy()
    frame = Frame.from_arrays(**a, lighting={"a": other, "b": a["colour"] * 0.2})
    clean = OIDN()(frame)
    expected = direct(other, a["albedo"], a["normal"])
    np.testing.assert_array_equal(clean.extras["a"].data, expected)


def test_a_stack_is_filtered_by_threes():
    """`filter` on a bare stack: the beauty, then layers, as filtered one by one."""
    a = noisy(48, 64)
    frame = Frame.from_arrays(colour=a["colour"])
    stack = np.concatenate([a["colour"], a["colour"] * 0.25], axis=2)
    result = OIDN().filter(frame, stack)
    np.testing.assert_array_equal(result[:, :, :3], direct(a["colour"]))
    np.testing.assert_array_equal(result[:, :, 3:], direct(a["colour"] * np.float32(0.25)))


# ---------------------------------------------------------------- remarks, errors, stopping


def test_remarks_name_what_is_not_as_expected():
    a = noisy(32, 32)
    a["albedo"][3, 4] = 1.5
    remarks = OIDN()(Frame.from_arrays(**a)).notes
    assert any("1 pixels" in text for text in remarks)
    del a["albedo"]
    clean = OIDN()(Frame.from_arrays(**a))
    assert any("together with albedo" in text for text in clean.notes)
    np.testing.assert_array_equal(beauty(clean), direct(a["colour"]))


def test_library_errors_become_ours():
    image = np.ones((8, 8, 3), np.float32)
    with pytest.raises(EngineError, match="Open Image Denoise"):
        oidn.clean({"color": image, "normal": image}, Options())
    with pytest.raises(OptionError, match="no device"):
        oidn.clean({"color": image}, Options(device="tpu"))


def test_no_cuda_is_said_plainly():
    try:
        mitsuba_oidn.Device(mitsuba_oidn.DeviceType.CUDA)
    except mitsuba_oidn.Error:
        with pytest.raises(EngineError, match="--device cpu"):
            OIDN(device="cuda")(Frame.from_arrays(**noisy(8, 8)))
    else:
        clean = beauty(OIDN(device="cuda")(Frame.from_arrays(**noisy(32, 32))))
        assert np.isfinite(clean).all()


def test_progress_rises_and_can_stop():
    a = noisy(64, 64)
    frame = Frame.from_arrays(**a, lighting={"a": a["colour"] * 0.5})
    seen: list[float] = []
    OIDN().watched(lambda done, total, text: seen.append(done / total))(frame)
    assert seen == sorted(seen)
    assert 0 <= seen[0] < 0.1
    assert seen[-1] == pytest.approx(1.0)

    def broken(done: float, total: float, text: str) -> None:
        raise ValueError("in the callback")

    with pytest.raises(ValueError, match="in the callback"):
        OIDN().watched(broken)(frame)
    assert np.isfinite(beauty(OIDN()(frame))).all()


def test_threads_take_turns():
    """Frames filtered from several threads at once come out as one by one."""
    arrays = [noisy(64, 64, seed) for seed in range(4)]
    results: dict[int, np.ndarray] = {}

    def work(i: int) -> None:
        results[i] = beauty(OIDN()(Frame.from_arrays(**arrays[i])))

    threads = [threading.Thread(target=work, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for i, a in enumerate(arrays):
        np.testing.assert_array_equal(results[i], direct(a["colour"], a["albedo"], a["normal"]))


def test_ctrl_c_stops_at_once():
    """The library alone would finish first; the next call works as ever."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's "&" turns it off
    image = np.random.default_rng(0).random((1080, 1920, 3), np.float32)
    begun = threading.Event()

    def interrupt() -> None:
        begun.wait(30)
        os.kill(os.getpid(), signal.SIGINT)

    def watch(done: float, total: float, text: str) -> None:
        last.append(done)
        begun.set()

    last: list[float] = []
    threading.Thread(target=interrupt).start()
    with pytest.raises(KeyboardInterrupt):
        oidn.clean({"color": image}, Options(quality="fast"), watch)
    assert last[-1] < 0.9
    assert np.isfinite(oidn.clean({"color": image[:20, :20]}, Options())).all()


def test_images_are_let_go():
    """Kept filters keep no picture."""
    import gc
    import weakref

    image = np.ones((20, 20, 3), np.float32)
    gone = weakref.ref(image)
    oidn.clean({"color": image}, Options())
    del image
    gc.collect()
    assert gone() is None
    assert len(oidn._filters) <= 4


def test_import_is_lean():
    """The default model loads neither Dr.Jit nor what else is heavy."""
    code = (
        "import sys, numpy as np\n"
        "from lambent.filters.denoiser import create\n"
        "from lambent.frame.frame import Frame\n"
        "create('oidn')(Frame.from_arrays(colour=np.ones((8, 8, 3))))\n"
        "heavy = {'drjit', 'scipy', 'torch', 'mitsuba', 'OpenEXR', 'PIL', 'rich'}\n"
        "print(sorted(heavy & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
