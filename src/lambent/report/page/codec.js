"use strict";
// Decodes the pictures that report/codec.py packs: wavelet bands of log-coded radiance.

const CODE = 2048;   // display arrays hold round(L * CODE) in 16 bits
const TOE = 4096;    // L = log2(1 + TOE x)

async function inflate(text) {
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; i++) bytes[i] = binary.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Rows of `low` and `high` (both `width` wide) to rows 0, 2, 4 … and 1, 3, 5 … of the result.
function joinRows(low, high, n, m, width) {
  if (!m) return low;
  const out = new Float32Array((n + m) * width);
  for (let i = 0; i < n; i++) {
    const a = Math.max(i - 1, 0) * width, b = Math.min(i, m - 1) * width;
    const to = 2 * i * width, from = i * width;
    for (let x = 0; x < width; x++) out[to + x] = low[from + x] - (high[a + x] + high[b + x]) / 4;
  }
  for (let i = 0; i < m; i++) {
    const a = 2 * i * width, b = a + (i + 1 < n ? 2 : n > 1 ? -2 : 0) * width;
    const to = (2 * i + 1) * width, from = i * width;
    // Behind the border the picture goes on in a straight line.
    const p = i + 1 < n ? 0.5 : 1.5, q = i + 1 < n ? 0.5 : -0.5;
    for (let x = 0; x < width; x++) out[to + x] = high[from + x] + p * out[a + x] + q * out[b + x];
  }
  return out;
}

// The same along x: `low` is n wide, `high` m wide.
function joinColumns(low, high, n, m, height) {
  if (!m) return low;
  const width = n + m, out = new Float32Array(width * height);
  for (let y = 0; y < height; y++) {
    const l = y * n, h = y * m, o = y * width;
    for (let i = 0; i < n; i++) {
      out[o + 2 * i] = low[l + i] - (high[h + Math.max(i - 1, 0)] + high[h + Math.min(i, m - 1)]) / 4;
    }
    for (let i = 0; i < m; i++) {
      const at = o + 2 * i;
      out[at + 1] = high[h + i] + (i + 1 < n ? (out[at] + out[at + 2]) / 2
        : n > 1 ? 1.5 * out[at] - 0.5 * out[at - 2] : out[at]);
    }
  }
  return out;
}

async function unpack(packed) {
  const raw = await inflate(packed.data);
  const half = raw.length / 2, levels = packed.steps[0].length - 1;
  const sizes = [[packed.h, packed.w]];
  for (let i = 0; i < levels; i++) {
    const [h, w] = sizes[i];
    sizes.push([(h + 1) >> 1, (w + 1) >> 1]);
  }
  let at = 0;
  const take = (h, w, step) => {
    const band = new Float32Array(h * w);
    for (let i = 0; i < band.length; i++, at++) {
      const z = raw[at] | (raw[half + at] << 8);
      band[i] = step * (z & 1 ? -((z + 1) >> 1) : z >> 1);
    }
    return band;
  };
  return packed.steps.map((steps) => {
    let low = take(sizes[levels][0], sizes[levels][1], steps[levels]);
    for (let level = levels - 1; level >= 0; level--) {
      const [h, w] = sizes[level], [hl, wl] = sizes[level + 1];
      const above = take(hl, w - wl, steps[level]);
      const below = take(h - hl, wl, steps[level]);
      const corner = take(h - hl, w - wl, steps[level]);
      const left = joinRows(low, below, hl, h - hl, wl);
      const right = joinRows(above, corner, hl, h - hl, w - wl);
      low = joinColumns(left, right, wl, w - wl, h);
    }
    return low;
  });
}

// Radiance as 16-bit codes, three a pixel.
async function unpackRadiance(packed) {
  const [y, co, cg] = await unpack(packed);
  const codes = new Uint16Array(y.length * 3);
  const code = (l) => Math.min(65535, Math.max(0, Math.round(l * CODE)));
  for (let i = 0; i < y.length; i++) {
    const side = y[i] - cg[i] / 2;
    codes[3 * i] = code(side + co[i] / 2);
    codes[3 * i + 1] = code(y[i] + cg[i] / 2);
    codes[3 * i + 2] = code(side - co[i] / 2);
  }
  return codes;
}

// A map as bytes.
async function unpackMap(packed) {
  const [v] = await unpack(packed);
  return Uint8ClampedArray.from(v, (x) => x * 255);
}

function decodeValue(code) { return (2 ** (code / CODE) - 1) / TOE; }

// Display bytes for every code at an exposure in stops: clipped, sRGB.
function displayTable(stops) {
  const table = new Uint8Array(65536), factor = 2 ** stops;
  for (let c = 0; c < 65536; c++) {
    const x = decodeValue(c) * factor;
    if (x >= 1) { table.fill(255, c); break; }
    table[c] = 255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055) + 0.5;
  }
  return table;
}
