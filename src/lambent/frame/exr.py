"""EXR files in and out, bit for bit. Reading order: exrvalues, exrheader, exrpixels, this.

``exrheader`` walks the file's structure, ``exrpixels`` unpacks and packs chunks with OpenEXR's own
module, ``exrfile`` holds the records, ``exrwrite`` writes a file again.
"""

from __future__ import annotations

from lambent.frame.exrfile import ExrChannel, ExrFile, ExrPart, decode
from lambent.frame.exrwrite import encode

__all__ = ["ExrChannel", "ExrFile", "ExrPart", "decode", "encode"]
