"""Show what is in a file: parts, channels, which layer is what and why, and what looks wrong.

Values are decoded and counted: NaN, infinite, negative, huge. Hints tell of a splatted pixel
filter, tone-mapped colour and clamped half values, which denoisers suffer from.
"""

from __future__ import annotations
