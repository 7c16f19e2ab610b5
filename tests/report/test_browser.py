"""The report in a real browser, from disk: slider, table, exposure, grid, themes, no network."""

from __future__ import annotations

import shutil
from collections.abc import Iterator

import numpy as np
import pytest
from playwright.sync_api import sync_playwright

from lambent.metrics.compare import compare
from lambent.report import write_inspection, write_report
from lambent.report.codec import pack_radiance, unpack_radiance

CHROMIUM = next(
    (p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), None
)

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this machine"),
]

ARGUMENTS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]

#: The mean of a part of a canvas, as [r, g, b] of 0 … 255; part: left, top, right, bottom of 1.
MEAN = """([selector, l, t, r, b]) => {
  const c = document.querySelector(selector);
  const x = Math.round(l * c.width), y = Math.round(t * c.height);
  const w = Math.max(1, Math.round((r - l) * c.width));
  const h = Math.max(1, Math.round((b - t) * c.height));
  const k = new OffscreenCanvas(w, h).getContext('2d', {willReadFrequently: true});
  k.drawImage(c, -x, -y);
  const d = k.getImageData(0, 0, w, h).data, s = [0, 0, 0];
  for (let i = 0; i < d.length; i += 4) for (let j = 0; j < 3; j++) s[j] += d[i + j] / (w * h);
  return s;
}"""


@pytest.fixture(scope="module")
def browser() -> Iterator[object]:
    with sync_playwright() as engine:
        chromium = engine.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield chromium
        chromium.close()


@pytest.fixture(scope="module")
def comparison():
    """Red, green and blue pictures, so that one sees which is where."""
    g = np.random.default_rng(0)
    base = np.full((90, 160, 3), 0.05, np.float32)
    reference, red, green = base.copy(), base.copy(), base.copy()
    reference[..., 2] = 0.4
    red[..., 0] = 0.4
    green[..., 1] = 0.4
    red *= g.uniform(0.8, 1.2, red.shape).astype(np.float32)
    red[10, 20] = np.nan
    names = {"red <b>": red, "green": green}
    return compare(reference, names, exposure=1.0, details={"green": {"seconds": 0.5}})


@pytest.fixture(scope="module")
def report(comparison, tmp_path_factory):
    return write_report(tmp_path_factory.mktemp("report") / "r.html", comparison, title="Three")


class Visit:
    """A page, and everything it complained of or asked for."""

    def __init__(self, browser, path, **options) -> None:
        self.context = browser.new_context(viewport={"width": 1280, "height": 800}, **options)
        self.page = self.context.new_page()
        self.trouble: list[str] = []
        self.requests: list[str] = []
        self.page.on("console", lambda m: self.trouble.append(m.text))
        self.page.on("pageerror", lambda e: self.trouble.append(str(e)))
        self.page.on("request", lambda r: self.requests.append(r.url))
        self.page.goto(path.as_uri())

    def ready(self):
        self.page.wait_for_selector("html[data-ready=yes]", timeout=30_000)
        return self.page

    def mean(self, selector, *part):
        self.settle()
        return self.page.evaluate(MEAN, [selector, *part])

    def settle(self):
        self.page.evaluate(
            "() => new Promise(r => requestAnimationFrame(() => requestAnimationFrame(r)))"
        )

    def strongest(self, *part):
        return "rgb"[int(np.argmax(self.mean("#stage canvas", *part)))]


@pytest.fixture(scope="module")
def opened(browser, report):
    there = Visit(browser, report)
    there.ready()
    yield there
    there.context.close()


@pytest.fixture
def visit(opened):
    """The one open page, put back to how it starts; afterwards nothing may have been wrong."""
    page = opened.page
    page.locator("input[name=view][value=slider]").check(force=True)
    page.locator("input[name=show][value=picture]").check(force=True)
    page.select_option("#a", "1")
    page.select_option("#b", "2")
    page.locator("#reset").click()
    page.locator("#fit").click()
    page.locator("#divider").focus()
    page.keyboard.press("Home")
    for _ in range(5):
        page.keyboard.press("PageUp")
    opened.settle()
    yield opened
    assert opened.trouble == []
    asked = [u for u in opened.requests if not u.startswith(("file:", "data:", "blob:"))]
    assert asked == []


def test_the_slider_moves_by_mouse(visit):
    assert visit.strongest(0.3, 0.4, 0.45, 0.6) == "r"
    assert visit.strongest(0.55, 0.4, 0.7, 0.6) == "g"
    box = visit.page.locator("#divider").bounding_box()
    stage = visit.page.locator("#stage").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    visit.page.mouse.move(x, y)
    visit.page.mouse.down()
    visit.page.mouse.move(stage["x"] + stage["width"] * 0.8, y, steps=4)
    visit.page.mouse.up()
    assert visit.strongest(0.55, 0.4, 0.7, 0.6) == "r"
    assert visit.page.locator("#divider").get_attribute("aria-valuenow") == "80"


def test_the_slider_moves_by_keyboard(visit):
    divider = visit.page.locator("#divider")
    divider.focus()
    for _ in range(3):
        visit.page.keyboard.press("Shift+ArrowLeft")
    visit.page.keyboard.press("ArrowRight")
    visit.settle()
    assert divider.get_attribute("aria-valuenow") == "21"
    assert visit.strongest(0.3, 0.4, 0.45, 0.6) == "g"
    visit.page.keyboard.press("End")
    assert visit.strongest(0.55, 0.4, 0.7, 0.6) == "r"
    assert "red <b> on the left 100 percent" in divider.get_attribute("aria-valuetext")


def test_the_table_says_what_was_computed_and_sorts(visit, comparison):
    cells = (
        "() => [...document.querySelectorAll('#metrics tbody tr')].map(r => "
        "Object.fromEntries([...r.cells].slice(1).map(c => [c.dataset.metric, c.dataset.value])))"
    )
    rows = visit.page.evaluate(cells)
    for row, shown in zip(comparison.rows, rows, strict=True):
        for name, value in row.values.items():
            assert float(shown[name]) == pytest.approx(value, rel=1e-12), name
    names = "() => [...document.querySelectorAll('#metrics tbody th')].map(h => h.textContent)"
    assert visit.page.evaluate(names) == ["red <b>", "green"]
    visit.page.locator("#metrics thead button", has_text="relMSE").first.click()
    order = sorted(comparison.rows, key=lambda r: r.values["relmse"])
    assert visit.page.evaluate(names) == [r.name for r in order]
    visit.page.locator("#metrics thead button", has_text="relMSE").first.press("Enter")
    assert visit.page.evaluate(names) == [r.name for r in order[::-1]]


def test_exposure_changes_the_pictures_by_the_right_amount(visit):
    before = visit.mean("#stage canvas", 0.6, 0.4, 0.7, 0.6)
    visit.page.locator("#exposure").focus()
    for _ in range(10):
        visit.page.keyboard.press("ArrowRight")
    assert visit.page.locator("#stops").text_content() == "+1.0"
    after = visit.mean("#stage canvas", 0.6, 0.4, 0.7, 0.6)
    transfer = lambda x: 255 * (1.055 * x ** (1 / 2.4) - 0.055)  # noqa: E731
    assert before[1] == pytest.approx(transfer(0.4), abs=1.5)
    assert after[1] == pytest.approx(transfer(0.8), abs=1.5)
    visit.page.locator("#reset").click()
    assert visit.mean("#stage canvas", 0.6, 0.4, 0.7, 0.6) == pytest.approx(before, abs=0.01)


def test_the_grid_shows_all_and_zooms_all_at_once(visit):
    visit.page.locator("input[name=view][value=grid]").check()
    panes = visit.page.locator("#stage .pane")
    assert panes.count() == 3
    assert panes.all_text_contents() == ["reference", "red <b>", "green"]
    box = panes.nth(1).bounding_box()
    visit.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    first = visit.page.locator("#zoom").text_content()
    visit.page.mouse.wheel(0, -400)
    visit.settle()
    assert visit.page.locator("#zoom").text_content() != first
    pictures = "() => [...document.querySelectorAll('#stage canvas')].map(c => c.toDataURL())"
    zoomed = visit.page.evaluate(pictures)
    visit.page.locator("#stage").focus()
    visit.page.keyboard.press("0")
    visit.settle()
    fitted = visit.page.evaluate(pictures)
    assert all(a != b for a, b in zip(zoomed, fitted, strict=True))
    assert visit.page.locator("#zoom").text_content() == first


def test_the_loupes_follow_the_pointer_over_all_images(visit):
    stage = visit.page.locator("#stage").bounding_box()
    visit.page.mouse.move(stage["x"] + stage["width"] / 2 - 30, stage["y"] + stage["height"] / 2)
    visit.settle()
    first = visit.page.locator("#where").text_content()
    visit.page.mouse.move(stage["x"] + stage["width"] / 2 + 60, stage["y"] + stage["height"] / 2)
    visit.settle()
    assert visit.page.locator("#where").text_content() != first
    values = visit.page.locator("#loupes figcaption span").all_text_contents()
    assert len(values) == 3
    # Blue is 0.4 in the reference, green in the last: the loupe reads radiance.
    assert float(values[0].split()[2]) == pytest.approx(0.4, rel=0.03)
    assert float(values[2].split()[1]) == pytest.approx(0.4, rel=0.03)


def test_keys_work_without_a_click_first(visit):
    zoom = visit.page.locator("#zoom")
    fitted = zoom.text_content()
    visit.page.keyboard.press("o")
    visit.settle()
    assert zoom.text_content() == "100 %" != fitted
    visit.page.keyboard.press("0")
    visit.settle()
    assert zoom.text_content() == fitted


def test_number_keys_show_one_picture_and_b_blinks(visit):
    """Keys as in tev: numbers choose, with Shift the other; b changes between both."""
    press = visit.page.keyboard.press
    for key, colour in (("1", "b"), ("2", "r"), ("Shift+Digit3", "g"), ("b", "r"), ("b", "g")):
        press(key)
        assert visit.strongest(0.3, 0.4, 0.7, 0.6) == colour, key
        assert visit.page.locator("#stage canvas").count() == 1
    press("9")  # there is no ninth
    assert visit.strongest(0.3, 0.4, 0.7, 0.6) == "g"
    press("g")
    assert visit.page.locator("#stage canvas").count() == 3
    press("2")
    assert visit.page.locator("#stage .tag").all_text_contents() == ["red <b>"]
    press("s")
    assert visit.strongest(0.3, 0.4, 0.45, 0.6) == "r"
    assert visit.strongest(0.55, 0.4, 0.7, 0.6) == "g"


@pytest.mark.parametrize(
    ("size", "columns"), [((1280, 900), 2), ((2200, 1200), 2), ((390, 844), 1)]
)
def test_the_grid_has_two_columns_and_fills_the_window(browser, report, size, columns):
    there = Visit(browser, report)
    there.page.set_viewport_size({"width": size[0], "height": size[1]})
    page = there.ready()
    page.locator("input[name=view][value=grid]").check(force=True)
    there.settle()
    boxes = [pane.bounding_box() for pane in page.locator("#stage .pane").all()]
    there.context.close()
    assert len({round(box["x"]) for box in boxes}) == columns
    left, right = min(b["x"] for b in boxes), max(b["x"] + b["width"] for b in boxes)
    assert right - left > size[0] - 60
    rows = boxes[::columns]
    if columns == 2:
        assert rows[-1]["y"] + rows[-1]["height"] - rows[0]["y"] > 0.75 * size[1]
    assert there.trouble == []


@pytest.mark.parametrize("width", [390, 1280])
def test_tables_fit(browser, comparison, tmp_path, width):
    """Nothing is to be scrolled to, with long names, a model and a time of every picture."""
    images = {p.name: p.image for p in comparison.pictures}
    names = {"a rather long name of a model, tuned": images["green"], "red": images["red <b>"]}
    about = {"model": "nfor-tuned", "seconds": 12.25, "cleaned": "combined, diffuse and 6 more"}
    found = compare(comparison.reference.image, names, details=dict.fromkeys(names, about))
    there = Visit(browser, write_report(tmp_path / "t.html", found))
    there.page.set_viewport_size({"width": width, "height": 800})
    page = there.ready()
    sizes = page.evaluate(
        "() => [...document.querySelectorAll('.scroll')].map(s => [s.scrollWidth, s.clientWidth])"
    )
    wide = page.evaluate("() => document.documentElement.scrollWidth")
    there.context.close()
    assert len(sizes) == 2
    assert all(inner <= outer for inner, outer in sizes), sizes
    assert wide <= width


def test_the_table_of_images_sorts_by_words_and_by_numbers(visit):
    names = "() => [...document.querySelectorAll('#images tbody th')].map(h => h.textContent)"
    visit.page.locator("#images thead button", has_text="Image").click()
    assert visit.page.evaluate(names) == ["green", "red <b>", "reference"]
    visit.page.locator("#images thead button", has_text="Not finite").click()
    visit.page.locator("#images thead button", has_text="Not finite").click()
    assert visit.page.evaluate(names)[0] == "red <b>"


def test_keys_of_the_stage(visit):
    visit.page.locator("#stage").focus()
    visit.page.keyboard.press("o")
    visit.settle()
    assert visit.page.locator("#zoom").text_content() == "100 %"
    before = visit.page.locator("#where").text_content()
    visit.page.keyboard.press("Shift+ArrowRight")
    visit.settle()
    column = int(before.split()[1])
    assert visit.page.locator("#where").text_content().startswith(f"x {column + 1} ")
    visit.page.keyboard.press("x")
    assert visit.page.locator("#a").input_value() == "2"
    visit.page.keyboard.press("]")
    assert visit.page.locator("#stops").text_content() == "+0.5"


def test_error_maps_are_shown_with_their_legend(visit, comparison):
    visit.page.locator("input[name=show][value=flip-ldr]").check()
    stage = visit.page.locator("#stage").bounding_box()
    visit.page.mouse.move(stage["x"] + stage["width"] / 2 + 2, stage["y"] + stage["height"] / 2 + 2)
    visit.page.wait_for_function(
        "() => document.querySelectorAll('#loupes span')[2].textContent !== ''"
    )
    assert visit.page.locator(".legend[data-map=flip-ldr]").is_visible()
    assert not visit.page.locator(".legend[data-map=relmse]").is_visible()
    value = float(visit.page.locator("#loupes figcaption span").nth(2).text_content())
    expected = comparison.map("green", "flip-ldr")[45, 80]
    assert value == pytest.approx(float(expected), abs=0.03)


def test_pixels_that_are_not_finite_are_marked(visit):
    visit.page.locator("#a").select_option("1")
    visit.page.locator("#stage").focus()
    visit.settle()
    magenta = visit.page.evaluate(
        """() => { const c = document.querySelector('#stage canvas');
        const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
        let n = 0;
        for (let i = 0; i < d.length; i += 4)
          n += d[i] === 255 && d[i + 1] === 0 && d[i + 2] === 255;
        return n; }"""
    )
    assert magenta > 0


def test_the_javascript_decoder_agrees_with_the_python_one(browser, tmp_path):
    # Odd sizes, HDR and black pixels; read back through the codes of a loupe-free call.
    image = np.random.default_rng(5).gamma(0.5, 1.0, (37, 53, 3)).astype(np.float32)
    path = write_report(tmp_path / "c.html", compare(None, {"a": image}, exposure=1.0))
    there = Visit(browser, path)
    page = there.ready()
    codes = page.evaluate(
        """async () => { const d = JSON.parse(document.getElementById('data').textContent);
        return [...await unpackRadiance(d.images[0].packed)].map(decodeValue); }"""
    )
    there.context.close()
    expected = unpack_radiance(pack_radiance(image, 1.0))
    assert np.allclose(np.reshape(codes, image.shape), expected, rtol=5e-4, atol=1e-6)
    assert there.trouble == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_light_and_dark_follow_the_system_and_the_toggle(browser, report, scheme):
    there = Visit(browser, report, color_scheme=scheme)
    page = there.ready()
    ground = "() => getComputedStyle(document.body).backgroundColor"

    def brightness():
        return sum(int(v) for v in page.evaluate(ground)[4:-1].split(",")) / 3

    assert (brightness() > 128) == (scheme == "light")
    page.locator("input[name=theme][value=dark]").check()
    assert brightness() < 128
    page.locator("input[name=theme][value=light]").check()
    assert brightness() > 128
    there.context.close()
    assert there.trouble == []


@pytest.mark.parametrize("width", [360, 1280])
def test_nothing_sticks_out_at_any_width(browser, report, width):
    there = Visit(browser, report)
    page = there.ready()
    page.set_viewport_size({"width": width, "height": 700})
    there.settle()
    wide = page.evaluate("() => document.documentElement.scrollWidth")
    there.context.close()
    assert wide <= width


def test_a_denoising_without_reference_works_too(browser, comparison, tmp_path):
    images = {p.name: p.image for p in comparison.pictures}
    path = write_report(tmp_path / "d.html", images, title="Denoised")
    there = Visit(browser, path)
    page = there.ready()
    page.locator("input[name=show][value=smape]").check()
    assert page.locator(".legend").first.is_visible()
    assert page.locator("#metrics").count() == 0
    assert page.locator("#images tbody tr").count() == 2
    there.context.close()
    assert there.trouble == []


def test_an_inspection_page_opens_without_complaint(browser, tmp_path):
    path = write_inspection(
        tmp_path / "i.html",
        {"path": "a.exr", "layers": [{"name": "<script>alert(1)</script>", "role": "colour"}]},
        {"<script>alert(1)</script>": np.ones((8, 8, 3))},
    )
    there = Visit(browser, path)
    assert there.page.locator("tbody th").text_content() == "<script>alert(1)</script>"
    assert there.page.locator("tbody img").evaluate("i => i.naturalWidth") == 8
    there.context.close()
    assert there.trouble == []
