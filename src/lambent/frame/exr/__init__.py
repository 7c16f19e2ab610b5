"""EXR files in and out, bit for bit.

Reading order: `file` (the records, and `decode`), `header` (the file's structure, checked in
Python before any pixel is decoded), `values` (attributes), `pixels` (chunks to arrays and back,
with OpenEXR's own module as the codec), `whole` (the module does a whole file by itself: the quick
way), `write` (the same file with other pixels), `new` (a file from a frame), `frame` (layers of a
frame from parts and back), `module` (calls of OpenEXR, its prints and errors caught).
"""

from __future__ import annotations

from lambent.frame.exr.file import ExrChannel, ExrFile, ExrPart, decode
from lambent.frame.exr.write import encode

__all__ = ["ExrChannel", "ExrFile", "ExrPart", "decode", "encode"]
