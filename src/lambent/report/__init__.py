"""One self-contained HTML page from results.

`write_report` for comparisons and denoised pictures, `write_inspection` for what a file holds,
`write_rendering` for a picture as it grows.
"""

from lambent.report.comparison import write_report
from lambent.report.inspection import write_inspection
from lambent.report.rendering import write_rendering

__all__ = ["write_inspection", "write_rendering", "write_report"]
