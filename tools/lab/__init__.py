"""The laboratory: every experiment of this project, run by one command, `python -m tools.lab`.

An experiment answers a question: a module with `Options`, a frozen dataclass, and `run(options, lab)`, which gives a
`Page`. `experiments` lists all of them, `figures` says which command makes which figure of which document. What
experiments are made of is named here.
"""

from airgs_codec._report import PagePicture, Section, Table
from airgs_codec._settings import required, setting
from tools.lab.command import Lab, main
from tools.lab.page import COLOURS, Page, Row, listed, plain_log_ticks, rows_of
from tools.lab.results import Results, content
from tools.lab.timing import Took, alone, middle, seconds_of, timed

__all__ = [
    "COLOURS", "Lab", "Page", "PagePicture", "Results", "Row", "Section", "Table", "Took", "alone", "content", "listed",
    "main", "middle", "plain_log_ticks", "required", "rows_of", "seconds_of", "setting", "timed",
]  # fmt: skip
