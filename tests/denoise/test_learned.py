"""Lambent's own network as a denoiser: sums, alpha, grey, tiles, subsets, model files."""

import json
import zipfile

import numpy as np
import pytest

from lambent.denoise import model_file
from lambent.denoise.learned import Lambent, LambentBest, LambentFast
from lambent.denoise.pipeline import Settings, clean
from lambent.denoise.tiles import filter_tiles, plan_tiles
from lambent.errors import DamagedFileError, FileError, OptionError, UnknownNameError
from lambent.filters.denoiser import create
from lambent.frame.frame import Frame
from lambent.frame.role import Role

every_size = pytest.mark.parametrize("kind", [Lambent, LambentFast, LambentBest])


def frame(height=96, width=128, seed=0, spp=4, grey=False, speckled=False):
    """Texture under soft light with noise in proportion; layers that sum.

    ``speckled``: a tenth of the pixels have the albedo of something else, but not its light.
    """
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32) / 64
    albedo = np.stack([0.5 + 0.4 * np.sin(9 * x), 0.5 + 0.4 * np.cos(8 * y), 0.5 + 0 * x], 2)
    if grey:
        albedo = np.repeat(albedo[:, :, :1], 3, axis=2)
    light = (0.3 + 0.2 * x * y)[:, :, None]
    diffuse = albedo * light * rng.gamma(spp, 1 / spp, (height, width, 1))
    specular = 0.1 * light * rng.gamma(spp / 4, 4 / spp, (height, width, 1)) * np.ones(3)
    colour = (diffuse + specular).astype(np.float32)
    normal = np.zeros((height, width, 3), np.float32)
    normal[:, :, 2] = 1
    if speckled:
        albedo = np.where(rng.random((height, width, 1)) < 0.1, 0.05, albedo)
    alpha = (rng.random((height, width, 1)) < 0.5).astype(np.float32)
    return Frame.from_arrays(
        spp=spp,
        colour=colour,
        diffuse=diffuse.astype(np.float32),
        specular=(colour - diffuse).astype(np.float32),
        albedo=albedo.astype(np.float32),
        normal=normal,
        depth=(2 + y)[:, :, None],
        alpha=alpha,
    )


def truth(made):
    y, x = np.mgrid[0 : made.height, 0 : made.width].astype(np.float32) / 64
    light = (0.3 + 0.2 * x * y)[:, :, None]
    return made[Role.ALBEDO] * light + 0.1 * light


def error(image, wanted):
    return float((((image - wanted) ** 2).mean(2) / (wanted.mean(2) ** 2 + 0.01)).mean())


@every_size
def test_it_cleans(kind):
    made = frame()
    wanted = truth(made)
    cleaned = kind()(made, "beauty").colour
    assert error(cleaned, wanted) < 0.1 * error(made.colour, wanted)


@every_size
def test_noise_of_the_albedo_is_not_the_results(kind):
    wanted = truth(frame())
    made = frame(speckled=True)
    assert error(made[Role.ALBEDO], frame()[Role.ALBEDO]) > 0.05
    cleaned = kind()(made, "beauty").colour
    assert error(cleaned, wanted) < 0.12 * error(made.colour, wanted)


@every_size
def test_layers_sum_and_alpha_is_coverage(kind):
    made = frame()
    result = clean(made, Settings.checked(model=kind.about.name, alpha=True)).frame
    total = result[Role.DIFFUSE] + result[Role.SPECULAR]
    np.testing.assert_allclose(total, result.colour, rtol=2e-5, atol=2e-6)
    alpha = result[Role.ALPHA]
    assert alpha.min() >= 0
    assert alpha.max() <= 1
    assert 0.3 < alpha.mean() < 0.7
    assert alpha.std() < 0.5 * made[Role.ALPHA].std()


def test_many_layers_are_filtered_like_one():
    made = frame()
    groups = {f"light{n}": made.colour * np.float32(n) for n in range(1, 8)}
    many = Frame.from_arrays(
        colour=made.colour, albedo=made[Role.ALBEDO], lighting=groups, spp=made.spp
    )
    result = Lambent()(many)
    for n in range(1, 8):
        np.testing.assert_allclose(result.extras[f"light{n}"].data, n * result.colour, rtol=1e-4)


def test_no_layer_of_the_frame_before_is_left():
    rich, plain = frame(), Frame.from_arrays(colour=frame(seed=1).colour)
    first = Lambent()(plain, "beauty").colour
    for between in (rich, plain, rich):
        Lambent()(between, "beauty")
        np.testing.assert_array_equal(Lambent()(plain, "beauty").colour, first)


@every_size
def test_grey_stays_grey(kind):
    cleaned = kind()(frame(grey=True), "beauty").colour
    # three channels of the same numbers take the same steps
    np.testing.assert_allclose(cleaned[:, :, 1], cleaned[:, :, 0], rtol=1e-5)
    np.testing.assert_allclose(cleaned[:, :, 2], cleaned[:, :, 0], rtol=1e-5)


def test_one_channel_is_a_grey_picture():
    made = frame(grey=True)
    one = Frame.from_arrays(colour=made.colour[:, :, :1])
    three = Frame.from_arrays(colour=np.repeat(made.colour[:, :, :1], 3, axis=2))
    a, b = Lambent()(one), Lambent()(three)
    np.testing.assert_allclose(a[Role.COLOUR][:, :, 0], b.colour[:, :, 0], rtol=1e-5)


def test_without_albedo_the_range_is_kept():
    made = Frame.from_arrays(colour=frame().colour)
    cleaned = Lambent()(made).colour
    assert cleaned.min() >= made.colour.min() - 1e-5
    assert cleaned.max() <= made.colour.max() + 1e-5


@every_size
@pytest.mark.parametrize("size", [(1, 1), (31, 33), (32, 64), (97, 200)])
def test_any_size(size, kind):
    result = kind()(frame(*size), "beauty").colour
    assert result.shape == (*size, 3)
    assert np.isfinite(result).all()


@every_size
def test_tiles_are_the_whole(kind):
    made = frame(576, 640, seed=3)
    model = kind().fitted(made)
    layers = [made.layer(Role.COLOUR), made.layer(Role.ALPHA)]
    whole = model.filter_layers(made, layers)
    per_pixel = model.bytes_per_pixel(4)
    plan = plan_tiles(576, 640, per_pixel, model.margin(), 576 * 520 * per_pixel)
    assert len(plan.tiles) > 1
    for a, b in zip(filter_tiles(model, made, layers, plan), whole, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-5)


def test_nothing_beyond_the_margin_counts():
    made = frame(32, 512)
    changed = made.colour.copy()
    changed[:, : 512 - 192 - 32] *= 2
    model = Lambent().fitted(made)
    a = model.filter_layers(made, [made.layer(Role.COLOUR)])[0]
    other = made.with_layer(made.layer(Role.COLOUR).with_data(changed))
    b = model.filter_layers(other, [other.layer(Role.COLOUR)])[0]
    np.testing.assert_allclose(b[:, -32:], a[:, -32:], rtol=1e-5)
    assert np.abs(b[:, :64] - a[:, :64]).max() > 0.01


def test_preference_keeps_more_of_the_input():
    made = frame()
    plain = Lambent()(made, "beauty").colour
    kept = Lambent(preference=1.0)(made, "beauty").colour
    assert np.abs(kept - made.colour).mean() < np.abs(plain - made.colour).mean()
    with pytest.raises(OptionError, match="preference"):
        Lambent(preference=1.5)


def test_float32_agrees_with_the_short_type():
    made = frame()
    a, b = (Lambent(precision=p)(made, "beauty").colour for p in ("auto", "f32"))
    wanted = truth(made)
    assert error(a, wanted) == pytest.approx(error(b, wanted), rel=0.02)


def test_every_shipped_model_has_a_card():
    assert "lambent" in model_file.shipped()
    for name, path in model_file.shipped().items():
        card = create(name).card()
        for key in ("name", "recipe", "data", "hours", "score", "curve", "sha256"):
            assert key in card, (name, key)
        assert create(name).about.name == name
        assert path.stat().st_size < 8e6
    assert sum(path.stat().st_size for path in model_file.shipped().values()) < 8e6


# ------------------------------------------------------------------ model files


def rewritten(source, target, **changed):
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            data = changed.get(name.replace(".", "_"), old.read(name))
            if data is not None:
                new.writestr(name, data)
    return target


def test_a_damaged_model_is_named(tmp_path):
    path = tmp_path / "cut.lambent"
    path.write_bytes(model_file.find_model("lambent").read_bytes()[:-2000])
    with pytest.raises(DamagedFileError, match=r"cut\.lambent: is damaged"):
        Lambent(weights=str(path))(frame(32, 32))
    other = rewritten(
        model_file.find_model("lambent"), tmp_path / "other.lambent", network_bin=b"\0" * 1000
    )
    with pytest.raises(DamagedFileError, match=r"network\.bin does not match its checksum"):
        model_file.read_model(other)


def test_a_foreign_file_is_no_model(tmp_path):
    path = tmp_path / "text.lambent"
    path.write_text("hello")
    with pytest.raises(FileError, match="is not a Lambent model"):
        model_file.read_model(path)
    with zipfile.ZipFile(tmp_path / "zip.lambent", "w") as archive:
        archive.writestr("a.txt", "b")
    with pytest.raises(FileError, match="is not a Lambent model"):
        model_file.read_model(tmp_path / "zip.lambent")
    with pytest.raises(FileError, match="no such file"):
        model_file.read_model(tmp_path / "none.lambent")
    with pytest.raises(UnknownNameError, match="lambent"):
        model_file.find_model("lambnt")


def test_another_version_is_refused(tmp_path):
    source = model_file.find_model("lambent")
    card = dict(model_file.read_model(source).card)
    path = rewritten(
        source, tmp_path / "old.lambent", card_json=json.dumps({**card, "inputs": 99}).encode()
    )
    with pytest.raises(FileError, match="another version"):
        model_file.read_model(path)


@pytest.mark.parametrize(("x", "y"), [(70, 40), (215, 220)])
def test_its_weights_can_be_explained(x, y):
    from lambent.filters.explain import explain

    made = frame(height=230, width=231, grey=True)
    model = Lambent().fitted(made)
    found = explain(made, model, x, y)
    cleaned = model(made, "beauty").colour[y, x]
    left, top = found.origin
    height, width = found.weights.shape
    seen = made.colour[top : top + height, left : left + width]
    np.testing.assert_allclose((found.weights[..., None] * seen).sum((0, 1)), cleaned, rtol=0.02)
