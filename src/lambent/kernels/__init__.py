"""Dr.Jit image kernels: arrays in, arrays out; one kernel family a file.

How a kernel is written here
----------------------------
1. Public functions take NumPy images ``(H, W, C)`` float32 and ``device="auto"``, and return NumPy.
   Inside, `arrays.Layout` fixes how the image lies in memory and `arrays.Planes` holds it: one
   plane a channel, rows of ``stride`` floats, empty columns at the right and empty rows above and
   below, so that *the neighbour at (dx, dy) of every pixel is the same flat array, shifted by
   dy·stride + dx*.
2. ``planes.view(channel, dx, dy)`` is that shifted array as a Dr.Jit ``Float`` of
   ``layout.size`` entries. On the processor it is a mapped window into the memory, without copy:
   a kernel reads it with plain vector loads. (A gather with a computed index, the obvious way, is
   ten times slower on AVX2: measured 2.4 s against 0.22 s for a joint bilateral filter.)
3. Plain Python loops over the taps of one or a few window rows unroll into one kernel; the groups
   of rows are launches of that same kernel (few launches: each reads all planes again). Compiled
   kernels are found again by what they compute *and by the alignment of every view*: cut each row
   at the same dx, and let nothing else vary. `@dr.freeze` is not used: tracing one row takes a
   millisecond and runs while the row before is computed, and a frozen function records again for
   every new pattern of alignments.
4. Numbers that change (σ, offsets) go in as ``dr.opaque`` arrays of one entry; a literal would
   compile a new kernel for each value.
   Take `extremes.greater` and `smaller`, not ``dr.maximum`` and ``dr.minimum`` (why: see there).
5. Empty pixels carry 0 in all planes, also in that of `arrays.valid_pixels`, the mask. Either every
   weight is multiplied with the mask, or Σw is summed as if the mask were one more channel. So
   borders are renormalised weights: nothing is reflected, and a NaN pixel never spreads.
6. A result of one kernel that the next reads at offsets is wrapped in an `arrays.Plane`; compute it
   ``extend`` rows further than the image where the reader looks up or down.
7. What this form does not reach, loops in loops with sums in registers and planes in the cache, is
   written as LLVM code in `machine`: NFOR's `dense_nlm` and `dense_regression` only, each beside
   the Dr.Jit kernel that it is tested against.
8. A public function ends in NumPy, which waits for the engine while its inputs are still alive.

Files: `arrays` (the above), `exponential` (a fast exp), `extremes` (greater, smaller), `window`
(weighted windows), `nlm` (patch distances and their windows), `atrous` (the wavelet), `separable`
(box and Gaussian means), `regression` (planes in feature space), `machine` (LLVM code),
`dense_nlm` and `dense_regression` (NFOR's, in it).
"""
