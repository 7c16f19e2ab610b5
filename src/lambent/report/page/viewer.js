// The picture viewer: slider, one picture and grid, synchronous pan and zoom, loupes, exposure, error maps.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const $ = (id) => document.getElementById(id);
  const [W, H] = data.size;
  const stage = $("stage"), divider = $("divider"), status = $("status");
  const images = data.images.map((image) => ({ ...image, bad: new Set(image.bad), codes: null, canvas: null, drawn: null }));
  const palette = Uint8Array.from(atob(data.colours), (c) => c.charCodeAt(0));
  const LOUPE = 21;

  const state = {
    view: "slider", show: "picture", a: data.a, b: data.b, blink: false, stops: 0, split: 0.5,
    fit: true, scale: 1, x: W / 2, y: H / 2, point: [Math.floor(W / 2), Math.floor(H / 2)],
  };
  let table = displayTable(0);
  let panes = [];

  // ------------------------------------------------------------ pixels to canvases

  function pictureCanvas(image) {
    if (!image.codes) return null;
    if (image.canvas && image.drawn === state.stops) return image.canvas;
    image.canvas ??= Object.assign(document.createElement("canvas"), { width: W, height: H });
    const context = image.canvas.getContext("2d");
    const pixels = context.createImageData(W, H), out = pixels.data, codes = image.codes;
    for (let i = 0, j = 0, n = W * H * 3; i < n; i += 3, j += 4) {
      out[j] = table[codes[i]];
      out[j + 1] = table[codes[i + 1]];
      out[j + 2] = table[codes[i + 2]];
      out[j + 3] = 255;
    }
    for (const i of image.bad) out.set([255, 0, 255], 4 * i);
    context.putImageData(pixels, 0, 0);
    image.drawn = state.stops;
    return image.canvas;
  }

  function mapOf(image) {
    const map = data.maps.find((m) => m.id === state.show);
    return map ? { map, layer: map.layers[image.name] } : null;
  }

  function mapCanvas(image) {
    const { map, layer } = mapOf(image);
    if (layer.canvas) return layer.canvas;
    if (!layer.waiting) {
      layer.waiting = true;
      unpackMap(layer).then((values) => {
        const canvas = Object.assign(document.createElement("canvas"), { width: layer.w, height: layer.h });
        const context = canvas.getContext("2d");
        const pixels = context.createImageData(layer.w, layer.h);
        for (let i = 0; i < values.length; i++) {
          pixels.data.set(palette.subarray(3 * values[i], 3 * values[i] + 3), 4 * i);
          pixels.data[4 * i + 3] = 255;
        }
        context.putImageData(pixels, 0, 0);
        layer.values = values;
        layer.canvas = canvas;
        draw();
      }).catch((error) => say(`The ${map.title} map cannot be unpacked: ${error.message}`));
    }
    return null;
  }

  // What has no map (the reference, the first of two pictures) is shown as a picture.
  const mapped = (image) => state.show !== "picture" && Boolean(mapOf(image)?.layer);
  const shown = (image) => (mapped(image) ? mapCanvas(image) : pictureCanvas(image));
  const nameOf = (image) => image.name + (state.show === "picture" || mapped(image) ? "" : "  (picture)");

  // ------------------------------------------------------------ geometry

  function fitScale() {
    const pane = panes[0];
    if (!pane) return 1;
    const scale = Math.min(pane.canvas.clientWidth / W, pane.canvas.clientHeight / H);
    const ratio = window.devicePixelRatio || 1;
    return scale >= 3 ? Math.floor(scale * ratio) / ratio : scale;   // whole pixels stay whole
  }

  const scaleNow = () => (state.fit ? fitScale() : state.scale);
  const centreNow = () => (state.fit ? [W / 2, H / 2] : [state.x, state.y]);

  function toImage(pane, clientX, clientY) {
    const box = pane.canvas.getBoundingClientRect(), scale = scaleNow(), [cx, cy] = centreNow();
    return [cx + (clientX - box.left - box.width / 2) / scale, cy + (clientY - box.top - box.height / 2) / scale];
  }

  function clampView() {
    const pane = panes[0];
    if (!pane) return;
    const hx = pane.canvas.clientWidth / 2 / state.scale, hy = pane.canvas.clientHeight / 2 / state.scale;
    state.x = hx * 2 >= W ? W / 2 : Math.min(W - hx, Math.max(hx, state.x));
    state.y = hy * 2 >= H ? H / 2 : Math.min(H - hy, Math.max(hy, state.y));
  }

  function zoomTo(scale, anchor) {
    const before = scaleNow(), [cx, cy] = centreNow(), fitted = fitScale();
    if (fitted <= 1 && scale <= fitted) { state.fit = true; return draw(); }
    scale = Math.min(64, Math.max(Math.min(fitted, 1), scale));
    if (Math.abs(scale - 1) < 0.04) scale = 1;
    const [ax, ay] = anchor ?? [cx, cy];
    state.fit = false;
    state.scale = scale;
    state.x = ax + (cx - ax) * before / scale;
    state.y = ay + (cy - ay) * before / scale;
    clampView();
    draw();
  }

  // ------------------------------------------------------------ drawing

  function paint(context, pane, image, scale) {
    const canvas = shown(image);
    if (!canvas) return;
    const [cx, cy] = centreNow();
    const ratio = pane.ratio, w = pane.canvas.width, h = pane.canvas.height;
    context.imageSmoothingEnabled = scale * ratio < 1 || (state.fit && scale < 3);
    context.imageSmoothingQuality = "high";
    const left = Math.round(w / 2 - cx * scale * ratio), top = Math.round(h / 2 - cy * scale * ratio);
    context.drawImage(canvas, left, top, Math.round(W * scale * ratio), Math.round(H * scale * ratio));
  }

  function mark(context, pane, scale) {
    const [px, py] = state.point, [cx, cy] = centreNow(), ratio = pane.ratio;
    const x = pane.canvas.width / 2 + (px + 0.5 - cx) * scale * ratio;
    const y = pane.canvas.height / 2 + (py + 0.5 - cy) * scale * ratio;
    const half = Math.max(6, LOUPE / 2 * scale) * ratio;
    for (const [style, width] of [["rgb(0 0 0 / 0.55)", 3], ["rgb(255 255 255 / 0.9)", 1]]) {
      context.strokeStyle = style;
      context.lineWidth = width * ratio;
      context.strokeRect(x - half, y - half, 2 * half, 2 * half);
    }
  }

  let queued = false;
  function draw() {
    if (queued) return;
    queued = true;
    requestAnimationFrame(() => { queued = false; drawNow(); });
  }

  function drawNow() {
    const scale = scaleNow();
    for (const pane of panes) {
      const ratio = pane.ratio = window.devicePixelRatio || 1;
      const w = Math.round(pane.canvas.clientWidth * ratio), h = Math.round(pane.canvas.clientHeight * ratio);
      if (pane.canvas.width !== w || pane.canvas.height !== h) { pane.canvas.width = w; pane.canvas.height = h; }
      const context = pane.canvas.getContext("2d");
      context.clearRect(0, 0, w, h);
      if (state.view === "slider") {
        paint(context, pane, images[state.a], scale);
        context.save();
        context.beginPath();
        context.rect(Math.round(w * state.split), 0, w, h);
        context.clip();
        context.clearRect(0, 0, w, h);
        paint(context, pane, images[state.b], scale);
        context.restore();
      } else paint(context, pane, images[pane.index], scale);
      if (state.marked) mark(context, pane, scale);
    }
    if (state.view === "slider") {
      divider.style.left = `${state.split * 100}%`;
      const percent = Math.round(state.split * 100);
      divider.setAttribute("aria-valuenow", percent);
      divider.setAttribute("aria-valuetext", `${images[state.a].name} on the left ${percent} percent, ${images[state.b].name} on the right`);
    }
    $("zoom").textContent = scale >= 10 ? `${Math.round(scale)}×` : `${Math.round(scale * 100)} %`;
    stage.classList.toggle("fitted", state.fit);
    drawLoupes();
  }

  function label(value) {
    if (value === 0) return "0";
    const size = Math.abs(value);
    return size >= 1000 || size < 0.001 ? value.toExponential(1) : value.toPrecision(3);
  }

  function drawLoupes() {
    const [px, py] = state.point, r = (LOUPE - 1) / 2;
    $("where").textContent = `x ${px + data.offset[0]}  y ${py + data.offset[1]}`;
    for (const [index, loupe] of loupes.entries()) {
      const image = images[index];
      const context = loupe.canvas.getContext("2d");
      const pixels = context.createImageData(LOUPE, LOUPE);
      const picked = mapped(image) ? mapOf(image) : null;
      let text = "";
      for (let v = 0; v < LOUPE; v++) for (let u = 0; u < LOUPE; u++) {
        const x = px + u - r, y = py + v - r, j = 4 * (v * LOUPE + u);
        if (x < 0 || y < 0 || x >= W || y >= H) continue;
        const i = y * W + x;
        if (picked) {
          const layer = picked.layer;
          if (!layer.values) { mapCanvas(image); continue; }
          const mx = Math.min(layer.w - 1, Math.floor(x * layer.w / W)), my = Math.min(layer.h - 1, Math.floor(y * layer.h / H));
          const value = layer.values[my * layer.w + mx];
          pixels.data.set(palette.subarray(3 * value, 3 * value + 3), j);
          if (u === r && v === r) text = mapValue(picked.map, value / 255);
        } else {
          if (!image.codes) continue;
          if (image.bad.has(i)) pixels.data.set([255, 0, 255], j);
          else for (let c = 0; c < 3; c++) pixels.data[j + c] = table[image.codes[3 * i + c]];
          if (u === r && v === r) {
            text = image.bad.has(i) ? "not finite"
              : [0, 1, 2].map((c) => label(decodeValue(image.codes[3 * i + c]) / data.exposure)).join("  ");
          }
        }
        pixels.data[j + 3] = 255;
      }
      context.putImageData(pixels, 0, 0);
      loupe.value.textContent = text;
    }
  }

  function mapValue(map, t) {
    const [low, high] = map.limits;
    if (map.scale === "log") return (t <= 0 ? "≤ " : t >= 1 ? "≥ " : "") + label(low * (high / low) ** t);
    return label(low + (high - low) * t);
  }

  // ------------------------------------------------------------ panes and loupes

  function layout() {
    stage.dataset.view = state.view;
    for (const pane of panes) pane.root.remove();
    const list = state.view === "slider" ? [null]
      : state.view === "single" ? [state.blink ? state.b : state.a] : images.map((_, i) => i);
    panes = list.map((index) => {
      const root = document.createElement("div"), canvas = document.createElement("canvas");
      root.className = "pane";
      canvas.setAttribute("role", "img");
      root.append(canvas);
      if (index === null) {
        for (const [side, letter] of [["a", "A"], ["b", "B"]]) {
          const tag = document.createElement("span");
          tag.className = `tag ${side}`;
          tag.textContent = `${letter}  ${nameOf(images[state[side]])}`;
          root.append(tag);
        }
        canvas.setAttribute("aria-label", `${images[state.a].name} beside ${images[state.b].name}`);
      } else {
        const tag = document.createElement("span");
        tag.className = "tag a";
        tag.textContent = nameOf(images[index]);
        root.append(tag);
        canvas.setAttribute("aria-label", images[index].name);
      }
      stage.append(root);
      return { root, canvas, index, ratio: 1 };
    });
    divider.hidden = state.view !== "slider";
    if (!divider.hidden) panes[0].root.append(divider);
    $("pair").hidden = state.view === "grid";
    arrange();
  }

  function arrange() {
    const width = stage.clientWidth, room = Math.max(260, Math.min(window.innerHeight * 0.66, 900));
    let columns = 1, height = Math.min(room, Math.max(260, width * H / W));
    if (state.view === "grid") {
      // Two columns, and up to two rows in the window; a phone has one column.
      columns = width < 560 ? 1 : Math.min(2, images.length);
      const rows = Math.ceil(images.length / columns);
      height = rows * Math.min(width / columns * H / W, Math.max(240, 0.94 * window.innerHeight / Math.min(rows, 2)));
    }
    stage.style.gridTemplateColumns = `repeat(${columns}, minmax(0, 1fr))`;
    stage.style.height = `${Math.round(height)}px`;
    if (!state.fit) clampView();
    draw();
  }

  const loupes = images.map((image) => {
    const figure = document.createElement("figure"), canvas = document.createElement("canvas");
    const caption = document.createElement("figcaption"), name = document.createElement("b"), value = document.createElement("span");
    canvas.width = canvas.height = LOUPE;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `Enlarged detail of ${image.name}`);
    name.textContent = image.name;
    name.title = image.name;
    caption.append(name, value);
    figure.append(canvas, caption);
    $("loupes").append(figure);
    return { canvas, value };
  });

  // ------------------------------------------------------------ controls

  function say(text) { status.textContent = text; }

  function chosen(name, then) {
    for (const input of document.querySelectorAll(`input[name="${name}"]`)) {
      input.addEventListener("change", () => { if (input.checked) then(input.value); });
    }
  }
  function check(name, value) {
    for (const input of document.querySelectorAll(`input[name="${name}"]`)) input.checked = input.value === value;
  }

  function setView(value) { state.view = value; state.blink = false; check("view", value); layout(); }
  function setShow(value) {
    state.show = value;
    check("show", value);
    for (const legend of document.querySelectorAll(".legend")) legend.hidden = legend.dataset.map !== value;
    layout();
  }
  function setPair(side, index) {
    state[side] = index;
    state.blink = state.view === "single" && side === "b";   // what was chosen is shown
    $(side).value = String(index);
    layout();
  }
  function setStops(value) {
    state.stops = Math.min(6, Math.max(-6, Math.round(value * 10) / 10));
    table = displayTable(state.stops);
    const text = `${state.stops > 0 ? "+" : state.stops < 0 ? "−" : ""}${Math.abs(state.stops).toFixed(1)}`;
    $("exposure").value = state.stops;
    $("exposure").setAttribute("aria-valuetext", `${text} stops`);
    $("stops").textContent = text;
    draw();
  }
  function setSplit(value) { state.split = Math.min(1, Math.max(0, value)); draw(); }
  function swap() { const a = state.a; setPair("a", state.b); setPair("b", a); }
  function setPoint(x, y) {
    state.point = [Math.min(W - 1, Math.max(0, Math.floor(x))), Math.min(H - 1, Math.max(0, Math.floor(y)))];
    draw();
  }

  chosen("view", setView);
  chosen("show", setShow);
  for (const side of ["a", "b"]) {
    for (const [index, image] of images.entries()) $(side).add(new Option(image.name, String(index)));
    $(side).value = String(state[side]);
    $(side).addEventListener("change", () => setPair(side, Number($(side).value)));
  }
  $("swap").addEventListener("click", swap);
  $("exposure").addEventListener("input", () => setStops(Number($("exposure").value)));
  $("reset").addEventListener("click", () => setStops(0));
  $("in").addEventListener("click", () => zoomTo(scaleNow() * 1.5, state.point));
  $("out").addEventListener("click", () => zoomTo(scaleNow() / 1.5, state.point));
  $("fit").addEventListener("click", () => { state.fit = true; draw(); });
  $("one").addEventListener("click", () => zoomTo(1, state.point));

  // ------------------------------------------------------------ pointer and keys

  let drag = null;
  const paneAt = (event) => panes.find((p) => p.root.contains(event.target)) ?? panes[0];

  stage.addEventListener("pointerdown", (event) => {
    if (event.button) return;
    const pane = paneAt(event);
    const onDivider = divider.contains(event.target) || (state.view === "slider" && state.fit);
    drag = { pane, onDivider, x: event.clientX, y: event.clientY, from: centreNow() };
    stage.setPointerCapture(event.pointerId);
    (onDivider ? divider : stage).focus({ preventScroll: true });
    if (onDivider) moveDivider(event);
    event.preventDefault();
  });
  function moveDivider(event) {
    const box = drag.pane.canvas.getBoundingClientRect();
    setSplit((event.clientX - box.left) / box.width);
  }
  stage.addEventListener("pointermove", (event) => {
    if (drag?.onDivider) moveDivider(event);
    else if (drag && !state.fit) {
      state.x = drag.from[0] - (event.clientX - drag.x) / state.scale;
      state.y = drag.from[1] - (event.clientY - drag.y) / state.scale;
      clampView();
    }
    state.marked = state.view === "grid" || event.pointerType !== "mouse";
    setPoint(...toImage(drag?.pane ?? paneAt(event), event.clientX, event.clientY));
  });
  const release = () => { drag = null; };
  stage.addEventListener("pointerup", release);
  stage.addEventListener("pointercancel", release);
  stage.addEventListener("wheel", (event) => {
    if (event.deltaY > 0 && state.fit) return;   // nothing to zoom out of: let the page scroll
    event.preventDefault();
    const factor = Math.exp(-Math.sign(event.deltaY) * Math.min(0.4, Math.abs(event.deltaY) / 400));
    zoomTo(scaleNow() * factor, toImage(paneAt(event), event.clientX, event.clientY));
  }, { passive: false });
  stage.addEventListener("dblclick", (event) => {
    if (state.fit) zoomTo(Math.max(4, fitScale() * 2), toImage(paneAt(event), event.clientX, event.clientY));
    else { state.fit = true; draw(); }
  });

  divider.addEventListener("keydown", (event) => {
    const step = event.shiftKey ? 0.1 : 0.01;
    const moves = { ArrowLeft: -step, ArrowDown: -step, ArrowRight: step, ArrowUp: step, PageDown: -0.1, PageUp: 0.1 };
    if (event.key in moves) setSplit(state.split + moves[event.key]);
    else if (event.key === "Home") setSplit(0);
    else if (event.key === "End") setSplit(1);
    else return;
    event.preventDefault();
    event.stopPropagation();
  });

  // Keys work wherever the focus is but where a person types; arrows scroll the page elsewhere.
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented) return;
    if (event.target.closest("input, select, textarea")) return;
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    if (event.key in arrows) {
      if (!stage.contains(event.target)) return;
      const step = event.shiftKey ? 1 : Math.max(1, Math.round(32 / scaleNow()));
      const [dx, dy] = arrows[event.key];
      state.marked = true;
      setPoint(state.point[0] + dx * step, state.point[1] + dy * step);
      if (!state.fit) { [state.x, state.y] = state.point; clampView(); }
    } else if (event.key === "+" || event.key === "=") zoomTo(scaleNow() * 1.5, state.point);
    else if (event.key === "-" || event.key === "_") zoomTo(scaleNow() / 1.5, state.point);
    else if (event.key === "0") { state.fit = true; draw(); }
    else if (event.key === "o") zoomTo(1, state.point);
    else if (/^Digit[1-9]$/.test(event.code)) {
      const index = Number(event.code.slice(5)) - 1;
      if (index >= images.length) return;
      if (state.view === "grid") setView("single");
      if (event.shiftKey) setPair("b", index);
      else { setView("single"); setPair("a", index); }
    } else if (event.key === "b") {
      if (state.view !== "single") setView("single");
      else { state.blink = !state.blink; layout(); }
    } else if (event.key === "s") { setView("slider"); stage.focus(); }
    else if (event.key === "[") setStops(state.stops - 0.5);
    else if (event.key === "]") setStops(state.stops + 0.5);
    else if (event.key === "x") { swap(); stage.focus(); }
    else if (event.key === "g") { setView(state.view === "grid" ? "slider" : "grid"); stage.focus(); }
    else return;
    event.preventDefault();
  });
  stage.addEventListener("focusout", () => { state.marked = false; draw(); });

  // ------------------------------------------------------------ start

  for (const canvas of document.querySelectorAll(".legend canvas")) {
    canvas.width = 256;
    canvas.height = 1;
    const context = canvas.getContext("2d"), pixels = context.createImageData(256, 1);
    for (let i = 0; i < 256; i++) pixels.data.set([...palette.subarray(3 * i, 3 * i + 3), 255], 4 * i);
    context.putImageData(pixels, 0, 0);
  }
  document.querySelector(".viewer").hidden = false;
  let lastWidth = 0;
  const resized = () => {
    if (stage.clientWidth === lastWidth) return;   // heights are this script's own doing
    lastWidth = stage.clientWidth;
    arrange();
  };
  new ResizeObserver(() => requestAnimationFrame(resized)).observe(stage.parentElement);
  window.addEventListener("resize", arrange);
  window.addEventListener("beforeprint", drawNow);
  setStops(0);
  layout();

  async function start() {
    if (typeof DecompressionStream === "undefined") {
      say("This browser is too old to unpack the pictures (it lacks DecompressionStream). The tables below are complete.");
      return;
    }
    const order = [...new Set([state.a, state.b, ...images.keys()])];
    for (const [count, index] of order.entries()) {
      say(`Unpacking pictures, ${count + 1} of ${order.length}`);
      images[index].codes = await unpackRadiance(images[index].packed);
      images[index].packed = null;
      draw();
    }
    say("");
    requestAnimationFrame(() => requestAnimationFrame(() => { document.documentElement.dataset.ready = "yes"; }));
  }
  start().catch((error) => say(`The pictures cannot be unpacked: ${error.message}`));
})();
