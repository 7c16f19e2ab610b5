"""One self-contained HTML page from results.

`write_report` for comparisons and denoised pictures, `write_inspection` for what a file holds.
"""

from lambent.report.comparison import write_report
from lambent.report.inspection import write_inspection

__all__ = ["write_inspection", "write_report"]
